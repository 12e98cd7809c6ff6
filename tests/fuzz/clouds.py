"""Small labelled clouds of a street, as their bytes lie in a message of each encoding."""

import base64
import json
import struct
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.timestamp_pb2 import DESCRIPTOR as TIMESTAMP_FILE
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S

Rows = NDArray[np.void]

ROW: Final = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "intensity")),
        ("t", "<u4"),
        ("ring", "<u2"),
        ("label", "<u2"),
        ("motion", "u1"),
        ("confidence", "<f4"),
    ]
)
LABELS: Final = ("label", "motion", "confidence")
ROS_KINDS: Final = {"u1": 2, "u2": 4, "u4": 6, "f4": 7}
FOXGLOVE_KINDS: Final = {"u1": 1, "u2": 3, "u4": 5, "f4": 7}

BEAMS, COLUMNS = 12, 72
BOX_POINTS = 60
STATIC, DYNAMIC = 1, 2
ROAD, CAR = 40, 10
CLASSES: Final = {
    str(ROAD): '{"name": "road", "movable": false, "moving": false}',
    str(CAR): '{"name": "car", "movable": true, "moving": false}',
}
SPACE: Final = "lidar"


def street(frame: int) -> Rows:
    """Make a frame: a bowl of ground and walls, a car that is missed, and one called moving."""
    rows = np.zeros(BEAMS * COLUMNS + 2 * BOX_POINTS, dtype=ROW)
    ground = rows[: BEAMS * COLUMNS]
    elevation_rad = np.deg2rad(np.repeat(np.linspace(-25.0, 5.0, BEAMS), COLUMNS))
    azimuth_rad = np.tile(np.linspace(-np.pi, np.pi, COLUMNS, endpoint=False), BEAMS)
    far_m = 12.0 + 3.0 * np.cos(3 * azimuth_rad) + np.sin(7 * azimuth_rad)
    range_m = np.minimum(far_m, 1.7 / np.maximum(np.sin(-elevation_rad), 1e-3))
    ground["x"] = range_m * np.cos(azimuth_rad) * np.cos(elevation_rad)
    ground["y"] = range_m * np.sin(azimuth_rad) * np.cos(elevation_rad)
    ground["z"] = range_m * np.sin(elevation_rad)
    ground["ring"] = np.repeat(np.arange(BEAMS), COLUMNS)
    ground["label"], ground["motion"] = ROAD, STATIC
    chance = np.random.default_rng(1)
    for number, (at_m, says) in enumerate((((6.0, 0.8 * frame - 3), STATIC), ((-6, 3), DYNAMIC))):
        first = BEAMS * COLUMNS + number * BOX_POINTS
        box = rows[first : first + BOX_POINTS]
        placed = chance.uniform((-2, -0.9, -1.5), (2, 0.9, 0.0), (BOX_POINTS, 3))
        box["x"], box["y"], box["z"] = placed[:, 0] + at_m[0], placed[:, 1] + at_m[1], placed[:, 2]
        box["label"], box["motion"] = CAR, says
    rows["t"] = np.linspace(0, 90_000_000, len(rows)).astype(np.uint32)
    rows["intensity"], rows["confidence"] = 40.0, 0.9
    return rows


def without(rows: Rows, names: tuple[str, ...]) -> Rows:
    """Leave fields out."""
    return _only(rows, tuple(name for name in rows.dtype.names or () if name not in names))


def labels_of(rows: Rows) -> Rows:
    """Keep what a topic of labels holds."""
    return _only(rows, LABELS)


def _only(rows: Rows, names: tuple[str, ...]) -> Rows:
    kept = np.zeros(len(rows), dtype=[(name, rows.dtype[name]) for name in names])
    for name in names:
        kept[name] = rows[name]
    return kept


def _fields(rows: Rows, kinds: Mapping[str, int]) -> list[tuple[str, int, int]]:
    described: Mapping[str, Any] = rows.dtype.fields or {}
    return [(name, int(at[1]), kinds[at[0].str[1:]]) for name, at in described.items()]


def cdr(rows: Rows, stamp_ns: int, *, order: str = "<") -> bytes:
    """Write a ROS 2 sensor_msgs/PointCloud2."""
    out = bytearray()

    def number(kind: str, value: int) -> None:
        out.extend(bytes(-len(out) % struct.calcsize(kind)))
        out.extend(struct.pack(order + kind, value))

    def text(value: str) -> None:
        number("I", len(value) + 1)
        out.extend(value.encode() + b"\0")

    number("i", stamp_ns // NS_PER_S)
    number("I", stamp_ns % NS_PER_S)
    text(SPACE)
    fields = _fields(rows, ROS_KINDS)
    for value in (1, len(rows), len(fields)):
        number("I", value)
    for name, offset, kind in fields:
        text(name)
        number("I", offset)
        number("B", kind)
        number("I", 1)
    number("B", 0)
    for value in (rows.itemsize, rows.nbytes, rows.nbytes):
        number("I", value)
    return bytes([0, order == "<", 0, 0]) + bytes(out) + rows.tobytes() + b"\1"


def cdr_big_endian(rows: Rows, stamp_ns: int) -> bytes:
    """Write it with its structure in the other byte order; its points stay as they are."""
    return cdr(rows, stamp_ns, order=">")


def ros1(rows: Rows, stamp_ns: int) -> bytes:
    """Write a ROS 1 sensor_msgs/PointCloud2, whose fields are not aligned."""

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    fields = _fields(rows, ROS_KINDS)
    out = struct.pack("<III", 0, stamp_ns // NS_PER_S, stamp_ns % NS_PER_S) + text(SPACE)
    out += struct.pack("<III", 1, len(rows), len(fields))
    for name, offset, kind in fields:
        out += text(name) + struct.pack("<IBI", offset, kind, 1)
    return (
        out
        + struct.pack("<BIII", 0, rows.itemsize, rows.nbytes, rows.nbytes)
        + (rows.tobytes() + b"\1")
    )


def foxglove_json(rows: Rows, stamp_ns: int) -> bytes:
    """Write a foxglove.PointCloud in JSON."""
    said: dict[str, Any] = {
        "timestamp": {"sec": stamp_ns // NS_PER_S, "nsec": stamp_ns % NS_PER_S},
        "frame_id": SPACE,
        "point_stride": rows.itemsize,
        "fields": [
            {"name": name, "offset": offset, "type": kind}
            for name, offset, kind in _fields(rows, FOXGLOVE_KINDS)
        ],
        "data": base64.b64encode(rows.tobytes()).decode(),
    }
    return json.dumps(said).encode()


def protobuf(rows: Rows, stamp_ns: int) -> bytes:
    """Write a foxglove.PointCloud in protobuf, by hand."""
    fields = b"".join(
        _framed(5, _framed(1, name.encode()) + _fixed32(2, offset) + _varint(3, kind))
        for name, offset, kind in _fields(rows, FOXGLOVE_KINDS)
    )
    stamp = _varint(1, stamp_ns // NS_PER_S) + _varint(2, stamp_ns % NS_PER_S)
    return (
        _framed(1, stamp)
        + _framed(2, SPACE.encode())
        + _fixed32(4, rows.itemsize)
        + fields
        + _framed(6, rows.tobytes())
    )


def protobuf_schema() -> bytes:
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
    timestamp = FileDescriptorProto.FromString(TIMESTAMP_FILE.serialized_pb)
    described: bytes = FileDescriptorSet(file=[timestamp, file]).SerializeToString()
    return described


Encoder = Callable[[Rows, int], bytes]
"""Rows and stamp to the payload of a message."""


def _number(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _varint(field: int, value: int) -> bytes:
    return _number(field << 3) + _number(value)


def _fixed32(field: int, value: int) -> bytes:
    return _number(field << 3 | 5) + struct.pack("<I", value)


def _framed(field: int, data: bytes) -> bytes:
    return _number(field << 3 | 2) + _number(len(data)) + data
