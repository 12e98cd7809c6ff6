"""The labels of the model that ran on the car: found, read exactly, and brought to their cloud."""

import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.frame import RecordedClass
from schemas.work import Channel, RecordedSource
from workers.errors import CloudUnreadableError, LogUnusableError
from workers.ingest.pointcloud import DecodedCloud
from workers.ingest.recorded_labels import (
    CLASSES_RECORD,
    MAX_WAITING,
    LabelPairing,
    find_recorded_source,
    recorded_classes,
    recorded_labels,
)

CLASSES = {
    "0": json.dumps({"name": "road", "movable": False, "moving": False}),
    "10": json.dumps({"name": "car", "movable": True, "moving": False}),
    "252": json.dumps({"name": "moving-car", "movable": True, "moving": True}),
}
METADATA = {CLASSES_RECORD: CLASSES}
LABEL = np.array([0, 10, 252, 65535], dtype=np.uint16)


def channel(topic: str) -> Channel:
    return Channel(
        topic=topic,
        message_encoding="cdr",
        schema_name="sensor_msgs/msg/PointCloud2",
        schema_encoding="ros2msg",
        schema_base64="",
        ids=((0, 1),),
    )


LIDAR, LABELS, OTHER = channel("/points"), channel("/labels"), channel("/depth")


def cloud(points: int = 4, *, stamp_ns: int = 100, **fields: NDArray[Any]) -> DecodedCloud:
    return DecodedCloud(
        stamp_ns=stamp_ns, frame_id="lidar", points=points, height=1, fields=fields, data=b""
    )


def labelled(*, stamp_ns: int = 100, value: int = 10) -> DecodedCloud:
    return cloud(stamp_ns=stamp_ns, label=np.full(4, value, dtype=np.uint16))


SOURCE = RecordedSource(channel=LABELS, classes_json=json.dumps(CLASSES))


def find(
    metadata: dict[str, dict[str, str]], **clouds: DecodedCloud
) -> tuple[RecordedSource | None, Channel | None]:
    source = find_recorded_source(
        [OTHER, LABELS, LIDAR],
        metadata,
        lidar=LIDAR,
        clouds={f"/{topic}": [decoded] for topic, decoded in clouds.items()},
    )
    return source, source.channel if source else None


def test_labels_are_found_in_the_fields_of_the_cloud_itself() -> None:
    source, where = find(METADATA, points=labelled(), labels=labelled())
    assert source is not None
    assert where is None


def test_labels_are_found_on_a_topic_with_the_stamp_and_width_of_the_cloud() -> None:
    plain = cloud(x=np.zeros(4))
    source, where = find(METADATA, points=plain, labels=labelled())
    assert source is not None
    assert where == LABELS
    assert recorded_classes(source.classes_json)[10] == RecordedClass("car", True, False)


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(labelled(stamp_ns=101), id="another stamp"),
        pytest.param(cloud(5, label=np.zeros(5, dtype=np.uint16)), id="another width"),
        pytest.param(cloud(x=np.zeros(4)), id="no labels"),
    ],
)
def test_a_topic_of_another_sensor_holds_no_labels_of_this_one(other: DecodedCloud) -> None:
    assert find(METADATA, points=cloud(), labels=other) == (None, None)


def test_labels_without_classes_count_only_if_they_state_motion() -> None:
    assert find({}, points=labelled())[0] is None
    motion = cloud(label=LABEL, motion=np.zeros(4, dtype=np.uint8))
    source, _ = find({}, points=motion)
    assert source is not None
    assert recorded_classes(source.classes_json) == {}


@pytest.mark.parametrize(
    "entry",
    ["car", "[]", '{"name": "car"}', '{"name": "car", "movable": 1, "moving": false}'],
)
def test_classes_that_say_something_else_are_refused(entry: str) -> None:
    with pytest.raises(LogUnusableError, match=r"class .10. of the metadata counterpoint\.classes"):
        find({CLASSES_RECORD: {"10": entry}}, points=labelled())
    with pytest.raises(LogUnusableError, match="class 'car'"):
        find({CLASSES_RECORD: {"car": CLASSES["10"]}}, points=labelled())


@pytest.mark.parametrize("order", ["<", ">"])
def test_labels_read_equal_labels_written(order: str) -> None:
    motion = np.array([0, 1, 2, 2], dtype=np.uint8)
    confidence = np.array([0, 0.25, 1 / 3, 1], dtype=np.float32)
    written = cloud(
        label=LABEL.astype(f"{order}u2"),
        motion=motion,
        confidence=confidence.astype(f"{order}f4"),
    )
    read = recorded_labels(written, SOURCE)
    np.testing.assert_array_equal(read.class_id, LABEL)
    np.testing.assert_array_equal(read.motion, motion)
    np.testing.assert_array_equal(read.confidence, confidence)
    assert read.classes[252] == RecordedClass("moving-car", True, True)


def test_motion_and_confidence_may_be_missing() -> None:
    read = recorded_labels(labelled(), SOURCE)
    assert read.motion is None
    assert read.confidence is None


def test_labels_in_other_types_are_read_where_they_are_whole_numbers() -> None:
    for dtype in (np.uint8, np.int32, np.float32):
        values = np.array([0, 1, 200, 7], dtype=dtype)
        np.testing.assert_array_equal(recorded_labels(cloud(label=values), SOURCE).class_id, values)


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"label": np.array([1, 2, 3, 65536])}, "'label' must hold one whole number"),
        ({"label": np.array([1, 2, 3, -1])}, "'label' must hold"),
        ({"label": np.array([1, 2, 3, 0.5])}, "'label' must hold"),
        ({"label": np.array([1, 2, 3, np.nan])}, "'label' must hold"),
        ({"label": LABEL, "motion": np.array([0, 1, 2, 300])}, "'motion' must hold"),
        ({"label": LABEL, "confidence": np.array([0, 1, 2.0, 0])}, "'confidence' must hold"),
        ({"label": LABEL, "confidence": np.full(4, np.nan)}, "'confidence' must hold"),
        ({"class": LABEL}, "no field 'label'; fields are class"),
    ],
)
def test_labels_that_cannot_be_what_they_should_are_refused(
    fields: dict[str, Any], problem: str
) -> None:
    with pytest.raises(CloudUnreadableError, match=problem):
        recorded_labels(cloud(**fields), SOURCE)


Done = list[tuple[int, int | None]]


def pair(*steps: tuple[str, int]) -> Done:
    """Feed clouds (`c`) and labels (`l`) by stamp; say which label each cloud left with."""
    pairing: LabelPairing[int] = LabelPairing(SOURCE)
    done: Done = []
    for kind, stamp_ns in steps:
        if kind == "c":
            out = pairing.add_cloud(cloud(stamp_ns=stamp_ns), stamp_ns)
        else:
            out = pairing.add_labels(labelled(stamp_ns=stamp_ns, value=stamp_ns))
        done += [(item, int(got.class_id[0]) if got else None) for item, got in out]
    rest = pairing.rest()
    return done + [(item, int(got.class_id[0]) if got else None) for item, got in rest]


@pytest.mark.parametrize(
    "steps",
    [
        pytest.param([("c", 1), ("l", 1), ("c", 2), ("l", 2)], id="at once"),
        pytest.param([("l", 1), ("c", 1), ("l", 2), ("c", 2)], id="before"),
        pytest.param([("c", 1), ("c", 2), ("l", 1), ("l", 2)], id="late"),
        pytest.param([("c", 1), ("c", 2), ("l", 2), ("l", 1)], id="out of order"),
    ],
)
def test_labels_come_to_their_cloud_whenever_they_arrive(steps: list[tuple[str, int]]) -> None:
    assert pair(*steps) == [(1, 1), (2, 2)]


def test_a_cloud_without_labels_leaves_in_its_place() -> None:
    assert pair(("c", 1), ("c", 2), ("l", 2)) == [(1, None), (2, 2)]


def test_a_cloud_waits_only_so_long_for_its_labels() -> None:
    clouds = [("c", stamp) for stamp in range(1, MAX_WAITING + 2)]
    assert pair(*clouds, ("l", 1), ("l", 2))[:2] == [(1, None), (2, 2)]


def test_a_cloud_recorded_twice_has_its_labels_twice() -> None:
    assert pair(("c", 1), ("c", 1), ("l", 1), ("c", 2), ("l", 2)) == [(1, 1), (1, 1), (2, 2)]


def test_labels_of_another_width_are_not_taken() -> None:
    pairing: LabelPairing[int] = LabelPairing(SOURCE)
    list(pairing.add_labels(labelled(stamp_ns=1)))
    assert list(pairing.add_cloud(cloud(3, stamp_ns=1), 1)) == []
    assert list(pairing.rest()) == [(1, None)]
