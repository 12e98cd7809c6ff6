"""Messages of boxes of every type are read as they were meant, and bad ones end in a sentence."""

import base64
import json
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from schemas.work import Channel
from tests.box_messages import (
    Box,
    Written,
    autoware,
    detections,
    header,
    published,
    ros1_detections,
    ros2,
    scene_json,
    scene_protobuf,
    xyz,
)
from workers.ingest.boxes.kinds import AUTOWARE_PACKAGES, box_kind
from workers.ingest.boxes.stated import StatedBoxes, stated_boxes
from workers.ingest.decoding import MessageUnreadableError
from workers.ingest.messages import RawMessage

STAMP_NS = 1_700_000_000_250_000_000
BOXES = (
    Box((10.0, -3.0, 0.5), yaw_rad=0.5, velocity_m_per_s=(3.0, 1.0, 0.0), track_id="a"),
    Box(
        (-20.0, 4.0, 0.2),
        size_m=(0.6, 0.7, 1.8),
        score=0.25,
        class_name="pedestrian",
        velocity_m_per_s=(0.0, 0.0, 0.0),
        track_id="b",
    ),
)


def read(written: Written, *, definition: bool = True) -> StatedBoxes:
    channel = Channel(
        topic="/objects",
        message_encoding=written.message_encoding,
        schema_name=written.schema_name,
        schema_encoding=written.schema_encoding if definition else "ros2idl",
        schema_base64=base64.b64encode(written.schema).decode(),
        ids=((0, 1),),
    )
    assert box_kind(channel) is not None
    return stated_boxes(RawMessage(channel, STAMP_NS + 70_000_000, written.data))


def tracked(package: str, name: str) -> Callable[..., Written]:
    def write(boxes: Sequence[Box], *, stamp_ns: int, frame_id: str) -> Written:
        return autoware(boxes, stamp_ns=stamp_ns, frame_id=frame_id, name=name, package=package)

    return write


AUTOWARE = [
    tracked(package, name)
    for package in AUTOWARE_PACKAGES
    for name in ("TrackedObjects", "PredictedObjects", "DetectedObjects")
]


@pytest.mark.parametrize(
    "write", [detections, published, scene_json, scene_protobuf, ros1_detections, *AUTOWARE]
)
def test_every_type_of_message_gives_the_same_boxes(write: Callable[..., Written]) -> None:
    found = read(write(BOXES, stamp_ns=STAMP_NS, frame_id="/base_link"))
    assert found.stamp_ns == STAMP_NS
    assert found.frame_id == "base_link"
    for index, box in enumerate(BOXES):
        np.testing.assert_allclose(found.place[index, :3, 3], box.centre_m)
        np.testing.assert_allclose(found.size_m[index], box.size_m)
        heading = np.arctan2(found.place[index, 1, 0], found.place[index, 0, 0])
        assert heading == pytest.approx(box.yaw_rad)
        assert found.score[index] == pytest.approx(box.score)
        if write in (detections, ros1_detections):
            assert np.isnan(found.velocity_m_per_s[index]).all()
        else:
            stated = found.velocity_m_per_s[index]
            np.testing.assert_allclose(stated, box.velocity_m_per_s or (), atol=1e-12)
    if write is ros1_detections:
        assert found.class_name == ("1", "7")
        assert found.track_id == ("", "")
    else:
        assert found.class_name == ("car", "pedestrian")
        tracks = write not in AUTOWARE[2::3]  # detected objects have no identity
        assert len(set(found.track_id)) == (2 if tracks else 1)


@pytest.mark.parametrize("write", [detections, *AUTOWARE])
def test_a_log_without_a_definition_is_read_by_the_published_one(
    write: Callable[..., Written],
) -> None:
    written = write(BOXES, stamp_ns=STAMP_NS, frame_id="map")
    with_text, without = read(written), read(written, definition=False)
    np.testing.assert_array_equal(with_text.place, without.place)
    np.testing.assert_array_equal(with_text.velocity_m_per_s, without.velocity_m_per_s)


def test_the_layout_of_ros_2_foxy_is_read_by_the_definition_in_the_log() -> None:
    """vision_msgs 2.0: text ids in the results, and a tracking id after the box."""
    text = "\n".join(
        (
            "std_msgs/Header header",
            "# A list of the detected proposals. A multi-proposal detector might generate",
            "vision_msgs/Detection3D[] detections",
            "=" * 80,
            "MSG: std_msgs/Header",
            "builtin_interfaces/Time stamp",
            "string frame_id",
            "=" * 80,
            "MSG: vision_msgs/Detection3D",
            "std_msgs/Header header",
            "vision_msgs/ObjectHypothesisWithPose[] results",
            "vision_msgs/BoundingBox3D bbox",
            "bool is_tracking",
            "string tracking_id",
            "=" * 80,
            "MSG: vision_msgs/ObjectHypothesisWithPose",
            "string id",
            "float64 score",
            "geometry_msgs/PoseWithCovariance pose",
            "=" * 80,
            "MSG: vision_msgs/BoundingBox3D",
            "geometry_msgs/Pose center",
            "geometry_msgs/Vector3 size",
            "=" * 80,
            "MSG: geometry_msgs/PoseWithCovariance",
            "geometry_msgs/Pose pose",
            "float64[36] covariance",
            "=" * 80,
            "MSG: geometry_msgs/Pose",
            "geometry_msgs/Point position",
            "geometry_msgs/Quaternion orientation",
            "=" * 80,
            "MSG: geometry_msgs/Point",
            "float64 x",
            "float64 y",
            "float64 z",
            "=" * 80,
            "MSG: geometry_msgs/Quaternion",
            "float64 x 0",
            "float64 y 0",
            "float64 z 0",
            "float64 w 1",
            "=" * 80,
            "MSG: geometry_msgs/Vector3",
            "float64 x",
            "float64 y",
            "float64 z",
        )
    )
    pose = {
        "position": xyz((5, 6, 7)),
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    }
    result = {"id": "CAR", "score": 0.5, "pose": {"pose": pose, "covariance": [0.0] * 36}}
    message = {
        "header": header(STAMP_NS, "lidar"),
        "detections": [
            {
                "header": header(STAMP_NS, "lidar"),
                "results": [{**result, "id": "BUS", "score": 0.25}, result],
                "bbox": {"center": pose, "size": xyz((4, 2, 1.5))},
                "is_tracking": True,
                "tracking_id": track_id,
            }
            for track_id in ("x17", "y")
        ],
    }
    found = read(ros2("vision_msgs/msg/Detection3DArray", text, message))
    assert found.track_id == ("x17", "y")
    assert found.class_name == ("CAR", "CAR")
    np.testing.assert_allclose(found.place[1, :3, 3], (5, 6, 7))


def test_boxes_that_no_object_can_have_are_counted_and_left_out() -> None:
    nan, good = float("nan"), Box((1.0, 2.0, 3.0))
    bad = [
        Box((nan, 0.0, 0.0)),
        Box((0.0, 0.0, float("inf"))),
        Box((0.0, 0.0, 0.0), size_m=(0.0, 1.0, 1.0)),
        Box((0.0, 0.0, 0.0), size_m=(4.0, 1e4, 1.0)),
        Box((0.0, 0.0, 0.0), size_m=(4.0, 2.0, -1.0)),
    ]
    found = read(detections([*bad, good], stamp_ns=STAMP_NS, frame_id="lidar"))
    assert len(found.size_m) == 1
    assert (found.not_finite, found.impossible_size) == (2, 3)


def test_too_many_boxes_are_refused_before_they_are_read() -> None:
    box = published([Box((1.0, 2.0, 3.0))], stamp_ns=STAMP_NS, frame_id="lidar")
    message = json.loads(box.data)
    message["boxes"] *= 50_000
    many = Written("json", box.schema_name, "jsonschema", b"{}", json.dumps(message).encode())
    with pytest.raises(MessageUnreadableError, match=r"1024|more than"):
        read(many)
    few = detections([Box((1.0, 2.0, 3.0))] * 5_000, stamp_ns=STAMP_NS, frame_id="lidar")
    with pytest.raises(MessageUnreadableError, match="more than"):
        read(few)


@pytest.mark.parametrize(
    "text",
    [
        "Empty[] many\n" + "=" * 80 + "\nMSG: vision_msgs/Empty\nuint8 A=1",
        "vision_msgs/Detection3DArray[] again",
        "uint8[999999999] long",
        "wstring name",
        "uint8 a\nnot a line of a definition at all !",
    ],
)
def test_a_definition_that_would_do_harm_is_refused_in_a_sentence(text: str) -> None:
    written = Written(
        "cdr",
        "vision_msgs/msg/Detection3DArray",
        "ros2msg",
        text.encode(),
        b"\0\1\0\0" + b"\xff" * 64,
    )
    with pytest.raises(MessageUnreadableError, match="its definition"):
        read(written)


@pytest.mark.parametrize("write", [detections, scene_protobuf, ros1_detections, *AUTOWARE[:1]])
def test_cut_messages_are_unreadable_and_nothing_else(write: Callable[..., Written]) -> None:
    whole = write(BOXES, stamp_ns=STAMP_NS, frame_id="map")
    rng = np.random.default_rng(3)
    for _ in range(200):
        data = bytearray(whole.data[: int(rng.integers(0, len(whole.data)))])
        if data:
            data[int(rng.integers(len(data)))] = int(rng.integers(256))
        damaged = Written(
            whole.message_encoding,
            whole.schema_name,
            whole.schema_encoding,
            whole.schema,
            bytes(data),
        )
        try:
            read(damaged)
        except MessageUnreadableError as error:
            assert "/objects" in str(error)  # noqa: PT017
