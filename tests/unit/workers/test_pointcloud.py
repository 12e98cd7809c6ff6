"""Decoding clouds: every encoding, odd layouts, and sizes that lie."""

import base64
import json
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import DESCRIPTOR as TIMESTAMP_FILE
from mcap.reader import NonSeekingReader
from mcap_ros1._vendor.genpy import Time
from mcap_ros1._vendor.genpy.dynamic import generate_dynamic
from mcap_ros2._dynamic import serialize_dynamic
from numpy.typing import NDArray

from schemas.work import Channel
from workers.errors import CloudUnreadableError
from workers.ingest.frames import frame_from_cloud
from workers.ingest.messages import RawMessage
from workers.ingest.pointcloud import DecodedCloud, decode_cloud, is_cloud, unsupported_reason
from workers.ingest.ros_definitions import ROS1_DEFINITIONS, ROS2_DEFINITIONS

SEC, NANOSEC = 1_700_000_000, 123_456_789
STAMP_NS = SEC * 1_000_000_000 + NANOSEC

ROS_KINDS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
FOXGLOVE_KINDS = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "f4": 7, "f8": 8}

Field = tuple[str, int, str, int]
"""Name, offset, numpy type without byte order, count."""

XYZ: tuple[Field, ...] = (("x", 0, "f4", 1), ("y", 4, "f4", 1), ("z", 8, "f4", 1))


@dataclass
class Ros:
    """A sensor_msgs/PointCloud2 before it is written; sizes may be made to lie."""

    data: bytes
    width: int
    fields: Sequence[Field] = XYZ
    step: int = 12
    height: int = 1
    row_step: int | None = None
    big_endian: bool = False

    def stated_row_step(self) -> int:
        return self.width * self.step if self.row_step is None else self.row_step


def channel(encoding: str, schema: str, *, schema_encoding: str = "", text: bytes = b"") -> Channel:
    return Channel(
        topic="/points",
        message_encoding=encoding,
        schema_name=schema,
        schema_encoding=schema_encoding,
        schema_base64=base64.b64encode(text).decode(),
        ids=((0, 1),),
    )


ROS2 = channel("cdr", "sensor_msgs/msg/PointCloud2", schema_encoding="ros2msg")
ROS1 = channel("ros1", "sensor_msgs/PointCloud2", schema_encoding="ros1msg")
JSON = channel("json", "foxglove.PointCloud", schema_encoding="jsonschema")


def decode(where: Channel, data: bytes) -> DecodedCloud:
    return decode_cloud(RawMessage(where, STAMP_NS + 5, memoryview(data)))


def cdr(cloud: Ros, *, order: str = "<") -> bytes:
    """Write CDR by hand, in either byte order: encapsulation, then aligned from byte 4 on."""
    body = bytearray()

    def number(kind: str, value: int) -> None:
        body.extend(b"\0" * (-len(body) % struct.calcsize(kind)))
        body.extend(struct.pack(order + kind, value))

    def text(value: str) -> None:
        number("I", len(value) + 1)
        body.extend(value.encode() + b"\0")

    number("i", SEC)
    number("I", NANOSEC)
    text("lidar_top")
    number("I", cloud.height)
    number("I", cloud.width)
    number("I", len(cloud.fields))
    for name, offset, kind, count in cloud.fields:
        text(name)
        number("I", offset)
        number("B", ROS_KINDS.get(kind, 99))
        number("I", count)
    number("B", cloud.big_endian)
    number("I", cloud.step)
    number("I", cloud.stated_row_step())
    number("I", len(cloud.data))
    body.extend(cloud.data)
    number("B", 1)
    return bytes([0, order == "<", 0, 0]) + bytes(body)


def ros1(cloud: Ros) -> bytes:
    """Write ROS 1 with the library's own message classes."""
    name = "sensor_msgs/PointCloud2"
    types: Any = generate_dynamic(name, ROS1_DEFINITIONS[name])  # type: ignore[no-untyped-call]
    message = types["sensor_msgs/PointCloud2"]()
    message.header.stamp = Time(SEC, NANOSEC)  # type: ignore[no-untyped-call]
    message.header.frame_id = "lidar_top"
    message.height, message.width = cloud.height, cloud.width
    for name, offset, kind, count in cloud.fields:
        message.fields.append(
            types["sensor_msgs/PointField"](
                name=name, offset=offset, datatype=ROS_KINDS[kind], count=count
            )
        )
    message.is_bigendian = cloud.big_endian
    message.point_step, message.row_step = cloud.step, cloud.stated_row_step()
    message.data, message.is_dense = cloud.data, True
    out = BytesIO()
    message.serialize(out)
    return out.getvalue()


def foxglove_json(data: bytes, *, stride: int, fields: Sequence[Field]) -> bytes:
    return json.dumps(
        {
            "timestamp": {"sec": SEC, "nsec": NANOSEC},
            "frame_id": "lidar_top",
            "pose": {
                "position": {"x": 0, "y": 0, "z": 0},
                "orientation": {"x": 0, "y": 0, "z": 0, "w": 1},
            },
            "point_stride": stride,
            "fields": [
                {"name": name, "offset": offset, "type": FOXGLOVE_KINDS[kind]}
                for name, offset, kind, _ in fields
            ],
            "data": base64.b64encode(data).decode(),
        }
    ).encode()


def foxglove_file() -> FileDescriptorProto:
    """Describe foxglove.PointCloud with its published field numbers, pose left out."""
    file = FileDescriptorProto(
        name="foxglove/PointCloud.proto", package="foxglove", syntax="proto3"
    )
    file.dependency.append(TIMESTAMP_FILE.name)
    element = file.message_type.add(name="PackedElementField")
    for number, (name, kind) in enumerate((("name", 9), ("offset", 7), ("type", 13)), start=1):
        element.field.add(name=name, number=number, type=kind, label=1)
    cloud = file.message_type.add(name="PointCloud")
    cloud.field.add(
        name="timestamp", number=1, type=11, label=1, type_name=".google.protobuf.Timestamp"
    )
    cloud.field.add(name="frame_id", number=2, type=9, label=1)
    cloud.field.add(name="point_stride", number=4, type=7, label=1)
    cloud.field.add(
        name="fields", number=5, type=11, label=3, type_name=".foxglove.PackedElementField"
    )
    cloud.field.add(name="data", number=6, type=12, label=1)
    return file


def foxglove_protobuf(
    data: bytes, *, stride: int, fields: Sequence[Field]
) -> tuple[Channel, bytes]:
    timestamp_file = FileDescriptorProto.FromString(TIMESTAMP_FILE.serialized_pb)
    files = FileDescriptorSet(file=[timestamp_file, foxglove_file()])
    pool = DescriptorPool()
    for file in files.file:
        pool.Add(file)
    message: Any = GetMessageClass(pool.FindMessageTypeByName("foxglove.PointCloud"))()
    message.timestamp.seconds, message.timestamp.nanos = SEC, NANOSEC
    message.frame_id, message.point_stride, message.data = "lidar_top", stride, data
    for name, offset, kind, _ in fields:
        message.fields.add(name=name, offset=offset, type=FOXGLOVE_KINDS[kind])
    where = channel(
        "protobuf",
        "foxglove.PointCloud",
        schema_encoding="protobuf",
        text=files.SerializeToString(),
    )
    return where, message.SerializeToString()


def xyz(points: int) -> NDArray[np.float32]:
    return np.arange(3 * points, dtype=np.float32).reshape(points, 3) - 4


def check_xyz(cloud: DecodedCloud, expected: NDArray[Any]) -> None:
    assert len(cloud) == len(expected)
    for axis, name in enumerate("xyz"):
        np.testing.assert_array_equal(cloud.fields[name], expected[:, axis])


def test_ros_2_clouds_decode_in_both_byte_orders_of_the_encapsulation() -> None:
    points = xyz(5)
    for order in "<>":
        cloud = decode(ROS2, cdr(Ros(points.tobytes(), width=5), order=order))
        assert (cloud.stamp_ns, cloud.frame_id) == (STAMP_NS, "lidar_top")
        check_xyz(cloud, points)


def test_what_the_ros_2_library_writes_is_what_is_read() -> None:
    name = "sensor_msgs/PointCloud2"
    points = xyz(4)
    message = {
        "header": {"stamp": {"sec": SEC, "nanosec": NANOSEC}, "frame_id": "lidar_top"},
        "height": 1,
        "width": 4,
        "fields": [
            {"name": n, "offset": offset, "datatype": 7, "count": 1} for n, offset, _, _ in XYZ
        ],
        "is_bigendian": False,
        "point_step": 12,
        "row_step": 48,
        "data": points.tobytes(),
        "is_dense": True,
    }
    data = serialize_dynamic(name, ROS2_DEFINITIONS[name])[name](message)
    check_xyz(decode(ROS2, data), points)
    assert data == cdr(Ros(points.tobytes(), width=4))


@pytest.mark.parametrize("schema_encoding", ["ros2idl", "omgidl", ""])
def test_a_cloud_whose_schema_is_written_in_idl_decodes_as_well(schema_encoding: str) -> None:
    where = channel("cdr", "sensor_msgs/msg/PointCloud2", schema_encoding=schema_encoding)
    check_xyz(decode(where, cdr(Ros(xyz(3).tobytes(), width=3))), xyz(3))


def test_big_endian_fields_are_read_whatever_the_encapsulation_says() -> None:
    points = xyz(5)
    data = points.astype(">f4").tobytes()
    for order in "<>":
        check_xyz(decode(ROS2, cdr(Ros(data, width=5, big_endian=True), order=order)), points)


def test_ros_1_clouds_decode() -> None:
    points = xyz(6)
    cloud = decode(ROS1, ros1(Ros(points.tobytes(), width=6)))
    assert (cloud.stamp_ns, cloud.frame_id) == (STAMP_NS, "lidar_top")
    check_xyz(cloud, points)


def test_a_ros_1_schema_of_a_log_is_never_run() -> None:
    """The library turns a definition into Python code; a log must not be able to bring its own."""
    text = b"string BAD='''\nraise SystemExit\n'''\nuint8 x"
    where = channel("ros1", "sensor_msgs/PointCloud2", schema_encoding="ros1msg", text=text)
    check_xyz(decode(where, ros1(Ros(xyz(2).tobytes(), width=2))), xyz(2))


def test_foxglove_clouds_decode_from_json_and_protobuf() -> None:
    points = xyz(7)
    data = foxglove_json(points.tobytes(), stride=12, fields=XYZ)
    clouds = [
        decode(JSON, data),
        decode(*foxglove_protobuf(points.tobytes(), stride=12, fields=XYZ)),
    ]
    for cloud in clouds:
        assert (cloud.stamp_ns, cloud.frame_id) == (STAMP_NS, "lidar_top")
        check_xyz(cloud, points)


def packed(fields: Sequence[Field], step: int, points: int, order: str) -> tuple[Any, bytes]:
    """Fill points of any layout with numbers that tell the fields apart; padding is noise."""
    dtype = np.dtype(
        {
            "names": [name for name, *_ in fields],
            "formats": [
                (order + kind, (count,)) if count > 1 else order + kind
                for _, _, kind, count in fields
            ],
            "offsets": [offset for _, offset, _, _ in fields],
            "itemsize": step,
        }
    )
    noise = np.random.default_rng(0).integers(0, 256, size=points * step, dtype=np.uint8)
    array = noise.view(dtype)
    for i, (name, *_) in enumerate(fields):
        array[name] = (np.arange(array[name].size) * 3 + i).reshape(array[name].shape) % 100
    return array, noise.tobytes()


LAYOUTS = {
    "padded, intensity first": (
        (("intensity", 24, "f4", 1), ("z", 8, "f4", 1), ("x", 0, "f4", 1), ("y", 4, "f4", 1)),
        32,
    ),
    "float64 unaligned": (
        (("flag", 0, "u1", 1), ("x", 1, "f8", 1), ("y", 9, "f8", 1), ("z", 17, "f8", 1)),
        25,
    ),
    "every type": (
        (*XYZ, *((kind, 12 + 8 * i, kind, 1) for i, kind in enumerate(ROS_KINDS))),
        12 + 8 * len(ROS_KINDS),
    ),
    "millimetres in int16": ((("x", 0, "i2", 1), ("y", 2, "i2", 1), ("z", 4, "i2", 1)), 6),
    "counts of none and many": (
        (("x", 0, "f4", 0), ("y", 4, "f4", 1), ("z", 8, "f4", 0), ("normal", 12, "f4", 3)),
        24,
    ),
}


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS.keys())
def test_fields_are_found_wherever_they_lie(
    layout: tuple[tuple[Field, ...], int], big_endian: bool
) -> None:
    fields, step = layout
    array, data = packed(fields, step, 9, ">" if big_endian else "<")
    message = Ros(data, width=9, fields=fields, step=step, big_endian=big_endian)
    for cloud in (decode(ROS2, cdr(message)), decode(ROS1, ros1(message))):
        assert set(cloud.fields) == {name for name, *_ in fields}
        for name in cloud.fields:
            np.testing.assert_array_equal(cloud.fields[name], array[name])


@pytest.mark.parametrize("last_row_padded", [True, False])
def test_rows_of_an_organised_cloud_may_be_padded(last_row_padded: bool) -> None:
    points = xyz(12)
    rows = points.reshape(3, 4, 3)
    data = b"".join(row.tobytes() + b"\xff" * 10 for row in rows)
    data = data if last_row_padded else data[:-10]
    cloud = decode(ROS2, cdr(Ros(data, width=4, height=3, row_step=58)))
    assert cloud.height == 3
    check_xyz(cloud, points)


@pytest.mark.parametrize("row_step", [0, 17, 10_000])
def test_a_row_step_that_says_nothing_is_ignored_where_the_data_fit(row_step: int) -> None:
    points = xyz(8)
    message = Ros(points.tobytes(), width=4, height=2, row_step=row_step)
    check_xyz(decode(ROS2, cdr(message)), points)


def test_nameless_fields_are_padding_and_the_first_of_a_name_counts() -> None:
    fields = (*XYZ, ("", 0, "u1", 1), ("", 4, "u1", 1), ("x", 8, "f4", 1))
    check_xyz(decode(ROS2, cdr(Ros(xyz(3).tobytes(), width=3, fields=fields))), xyz(3))


@pytest.mark.parametrize("step", [0, 12])
def test_an_empty_cloud_is_well_formed(step: int) -> None:
    cloud = decode(ROS2, cdr(Ros(b"", width=0, step=step)))
    assert len(cloud) == 0
    assert cloud.fields["x"].shape == (0,)
    assert len(decode(JSON, foxglove_json(b"", stride=step, fields=XYZ))) == 0


def test_a_zero_header_stamp_stays_zero() -> None:
    data = bytearray(cdr(Ros(xyz(1).tobytes(), width=1)))
    data[4:12] = bytes(8)
    assert decode(ROS2, bytes(data)).stamp_ns == 0


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        pytest.param(Ros(xyz(3).tobytes()[:-1], width=3), "fit its 35 bytes", id="short"),
        pytest.param(Ros(xyz(3).tobytes() + b"\0", width=3), "fit its 37 bytes", id="long"),
        pytest.param(
            Ros(xyz(3).tobytes(), width=2**31, row_step=36), "2147483648 points", id="width"
        ),
        pytest.param(Ros(xyz(3).tobytes(), width=3, step=0), "points of 0 bytes", id="step"),
        pytest.param(Ros(xyz(3).tobytes(), width=0), "no points but 36 bytes", id="no width"),
        pytest.param(
            Ros(xyz(3).tobytes(), width=3, fields=(*XYZ, ("t", 10, "f4", 1))),
            "'t' ends at byte 14 of points of 12",
            id="field beyond the point",
        ),
        pytest.param(
            Ros(xyz(3).tobytes(), width=3, fields=(*XYZ, ("n", 0, "f4", 4))),
            "'n' ends at byte 16 of points of 12",
            id="count beyond the point",
        ),
        pytest.param(
            Ros(xyz(3).tobytes(), width=3, fields=(*XYZ, ("t", 0, "?", 1))),
            "'t' has unknown type 99",
            id="type",
        ),
        pytest.param(
            Ros(xyz(4).tobytes() + b"--", width=2, height=2, row_step=30),
            "do not fit",
            id="row step",
        ),
    ],
)
def test_sizes_that_lie_are_refused_with_a_sentence(message: Ros, problem: str) -> None:
    with pytest.raises(CloudUnreadableError, match=problem) as caught:
        decode(ROS2, cdr(message))
    assert "/points" in str(caught.value)


def test_points_without_positions_are_refused_unless_they_are_labels() -> None:
    for name, refused in (("range", True), ("label", False)):
        message = Ros(b"\1\0\2\0", width=2, fields=((name, 0, "u2", 1),), step=2)
        if refused:
            with pytest.raises(CloudUnreadableError, match="no field x, y, z; fields are range"):
                decode(ROS2, cdr(message))
        else:
            assert decode(ROS2, cdr(message)).fields[name].tolist() == [1, 2]


def test_a_data_length_beyond_the_message_costs_no_memory() -> None:
    data = cdr(Ros(xyz(3).tobytes(), width=3))
    at = data.index(struct.pack("<I", 36) + xyz(1).tobytes()[:4], 60)
    lying = data[:at] + struct.pack("<I", 0xFFFFFFF0) + data[at + 4 :]
    with pytest.raises(CloudUnreadableError):
        decode(ROS2, lying)


def test_a_truncated_message_is_refused_wherever_it_ends() -> None:
    where, protobuf = foxglove_protobuf(xyz(2).tobytes(), stride=12, fields=XYZ)
    whole = {
        "ros2": (ROS2, cdr(Ros(xyz(2).tobytes(), width=2))),
        "ros1": (ROS1, ros1(Ros(xyz(2).tobytes(), width=2))),
        "json": (JSON, foxglove_json(xyz(2).tobytes(), stride=12, fields=XYZ)),
        "protobuf": (where, protobuf),
    }
    refused = 0
    for name, (by, data) in whole.items():
        for length in range(len(data)):
            try:
                cloud = decode(by, data[:length])
            except CloudUnreadableError:
                refused += 1
                continue
            # Only protobuf may end between two fields and be a message all the same.
            assert name == "protobuf"
            assert len(cloud) in (0, 2)
    assert refused > 500


def test_json_nested_without_end_is_refused() -> None:
    with pytest.raises(CloudUnreadableError, match="RecursionError"):
        decode(JSON, b'{"fields":' + b"[" * 200_000)


@pytest.mark.parametrize("name", ["ros2", "ros1", "json", "protobuf"])
def test_flipped_bits_make_a_cloud_or_a_refusal_and_nothing_else(name: str) -> None:
    fields = (*XYZ, ("t", 12, "u4", 1), ("intensity", 16, "f4", 1), ("ring", 20, "u2", 1))
    message = Ros(bytes(range(66)), width=3, fields=fields, step=22)
    where, data = {
        "ros2": (ROS2, cdr(message)),
        "ros1": (ROS1, ros1(message)),
        "json": (JSON, foxglove_json(message.data, stride=22, fields=fields)),
        "protobuf": foxglove_protobuf(message.data, stride=22, fields=fields),
    }[name]
    rng = np.random.default_rng(7)
    outcomes = {"read": 0, "refused": 0}
    for _ in range(400):
        flipped = np.frombuffer(data, dtype=np.uint8).copy()
        places = rng.integers(0, len(flipped), size=rng.integers(1, 4))
        flipped[places] ^= np.uint8(1) << rng.integers(0, 8, size=len(places), dtype=np.uint8)
        try:
            cloud = decode(where, flipped.tobytes())
            frame_from_cloud(
                cloud,
                log_id="log",
                log_time_ns=STAMP_NS,
                previous_stamp_ns=None,
                intensity_scale=255,
                stamp_at="start",
            )
            outcomes["read"] += 1
        except CloudUnreadableError:
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 0


@pytest.mark.parametrize(
    "change",
    [
        {"data": "?"},
        {"data": 7},
        {"fields": None},
        {"point_stride": 0},
        {"point_stride": 5},
        {"timestamp": None},
        {"fields": [{"name": "x", "offset": -4, "type": 7}]},
        {"fields": [{"name": "x", "offset": 0, "type": 0}]},
    ],
)
def test_json_that_is_no_cloud_is_refused(change: dict[str, Any]) -> None:
    message = json.loads(foxglove_json(xyz(2).tobytes(), stride=12, fields=XYZ))
    with pytest.raises(CloudUnreadableError):
        decode(JSON, json.dumps(message | change).encode())


def test_a_cloud_of_300_000_points_decodes_without_a_copy() -> None:
    data = cdr(Ros(np.zeros((300_000, 3), dtype=np.float32).tobytes(), width=300_000))
    cloud = decode(ROS2, data)
    assert len(cloud) == 300_000
    assert not cloud.fields["x"].flags.owndata


@pytest.mark.parametrize(
    ("encoding", "schema", "needs"),
    [
        ("protobuf", "foxglove.CompressedPointCloud", "Draco"),
        ("cdr", "point_cloud_interfaces/msg/CompressedPointCloud2", "Cloudini"),
        ("cdr", "velodyne_msgs/msg/VelodyneScan", "Velodyne"),
        ("ros1", "ouster_ros/PacketMsg", "Ouster"),
        ("cdr", "ouster_sensor_msgs/msg/PacketMsg", "Ouster"),
        ("cdr", "hesai_ros_driver/msg/UdpFrame", "Hesai"),
        ("ros1", "pandar_msgs/PandarScan", "Hesai"),
        ("cdr", "livox_ros_driver2/msg/CustomMsg", "Livox"),
        ("cdr", "rslidar_msg/msg/RslidarPacket", "Robosense"),
        ("cdr", "nebula_msgs/msg/NebulaPackets", "driver"),
        ("ros1", "sensor_msgs/PointCloud", "deprecated"),
        ("cdr", "sensor_msgs/msg/LaserScan", "single plane"),
        ("cbor", "sensor_msgs/msg/PointCloud2", "cbor"),
        ("x-vendor-lidar", "vendor/PackedScan", "x-vendor-lidar"),
    ],
)
def test_a_lidar_that_cannot_be_read_is_named_with_what_it_would_need(
    encoding: str, schema: str, needs: str
) -> None:
    where = channel(encoding, schema).model_copy(update={"topic": "/lidar/front"})
    assert needs in unsupported_reason(where)
    assert not is_cloud(where)
    with pytest.raises(CloudUnreadableError, match=needs):
        decode(where, b"")


@pytest.mark.parametrize(
    ("encoding", "schema"),
    [
        ("cdr", "sensor_msgs/msg/Image"),
        ("cdr", "std_msgs/msg/String"),
        ("protobuf", "foxglove.CompressedImage"),
        ("json", "Pose"),
        ("ros1", "tf2_msgs/TFMessage"),
    ],
)
def test_channels_that_have_nothing_of_a_lidar_need_nothing(encoding: str, schema: str) -> None:
    where = channel(encoding, schema)
    assert unsupported_reason(where) == ""
    assert not is_cloud(where)


def clouds_of(path: Path) -> Iterator[tuple[int, DecodedCloud]]:
    with path.open("rb") as file:
        for schema, recorded, message in NonSeekingReader(file).iter_messages():
            assert schema is not None
            where = channel(
                recorded.message_encoding,
                schema.name,
                schema_encoding=schema.encoding,
                text=schema.data,
            )
            if is_cloud(where):
                yield (
                    message.log_time,
                    decode_cloud(RawMessage(where, message.log_time, message.data)),
                )


@pytest.mark.reference
def test_real_logs_of_every_encoding_decode_to_the_points_that_were_recorded(
    reference: Path,
) -> None:
    truths = sorted((reference / "data" / "truth").rglob("frames.json"))
    assert len(truths) == 8
    for truth in truths:
        log = json.loads(truth.read_text())
        found = [
            (log_time_ns, cloud.stamp_ns, len(cloud), zlib.crc32(cloud.data))
            for log_time_ns, cloud in clouds_of(reference / "data" / log["log"])
        ]
        assert found == [
            (each["log_time"], each["header_stamp"], each["points"], each["data_crc32"])
            for each in log["frames"]
        ]


@pytest.mark.reference
def test_of_the_damaged_clouds_the_good_ones_are_read(reference: Path) -> None:
    path = reference / "data" / "mcap-zoo" / "damaged" / "d07_size_mismatch.mcap"
    good = []
    with path.open("rb") as file:
        for index, (schema, _, message) in enumerate(NonSeekingReader(file).iter_messages()):
            assert schema is not None
            try:
                decode_cloud(RawMessage(ROS2, message.log_time, message.data))
            except CloudUnreadableError:
                continue
            good.append(index)
    assert good == [0, 2, 4, 9]
