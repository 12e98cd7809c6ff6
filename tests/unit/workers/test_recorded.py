from collections.abc import Mapping

import numpy as np

from schemas.frame import LidarFrame, PosedFrame, RecordedClass, RecordedLabels
from schemas.labels import FrameLabels, MotionLabel
from workers.supervised.recorded import Recorded

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
CLASSES = {
    40: RecordedClass(name="road", movable=False, moving=False),
    10: RecordedClass(name="car", movable=True, moving=False),
    252: RecordedClass(name="moving car", movable=True, moving=True),
}


def _recorded(
    ids: list[int],
    motion: list[int] | None = None,
    confidence: list[float] | None = None,
    classes: Mapping[int, RecordedClass] = CLASSES,
) -> RecordedLabels:
    return RecordedLabels(
        class_id=np.array(ids, dtype=np.uint16),
        motion=None if motion is None else np.array(motion, dtype=np.uint8),
        confidence=None if confidence is None else np.array(confidence, dtype=np.float32),
        classes=classes,
    )


def _posed(recorded: RecordedLabels | None, n: int, stamp_ns: int = 0) -> PosedFrame:
    frame = LidarFrame(
        log_id="log",
        stamp_ns=stamp_ns,
        points_m=np.ones((n, 3), dtype=np.float32),
        intensity=np.zeros(n, dtype=np.float32),
        offset_ns=np.zeros(n, dtype=np.int32),
        ring=np.full(n, -1, dtype=np.int16),
        valid_mask=np.ones(n, dtype=np.bool_),
        recorded=recorded,
    )
    return PosedFrame(frame, np.eye(4))


def _one(recorded: RecordedLabels) -> tuple[FrameLabels, tuple[str, ...]]:
    stream = Recorded()
    (labels,) = stream([_posed(recorded, len(recorded.class_id))])
    return labels, stream.class_names


def test_recorded_motion_is_taken_as_it_is() -> None:
    labels, _ = _one(_recorded([252, 252, 10, 40], motion=[0, 1, 2, 2]))
    assert labels.labels.tolist() == [UNKNOWN, STATIC, DYNAMIC, DYNAMIC]


def test_without_recorded_motion_the_class_tells() -> None:
    labels, _ = _one(_recorded([252, 10, 40, 7]))
    assert labels.labels.tolist() == [DYNAMIC, STATIC, STATIC, UNKNOWN]


def test_a_motion_code_that_means_nothing_is_unknown() -> None:
    labels, _ = _one(_recorded([10, 10], motion=[3, 255]))
    assert labels.labels.tolist() == [UNKNOWN, UNKNOWN]


def test_classes_are_indices_into_names_ordered_by_id() -> None:
    labels, names = _one(_recorded([252, 10, 40, 7]))
    assert names == ("car", "road", "moving car")
    assert labels.class_id is not None
    assert labels.class_id.tolist() == [2, 0, 1, -1]


def test_a_class_declared_later_moves_no_earlier_index() -> None:
    stream = Recorded()
    later = {**CLASSES, 5: RecordedClass(name="tram", movable=True, moving=False)}
    frames = [_posed(_recorded([10]), 1), _posed(_recorded([10, 5], classes=later), 2, 1)]
    first, second = stream(frames)
    assert stream.class_names == ("car", "road", "moving car", "tram")
    assert first.class_id is not None
    assert second.class_id is not None
    assert first.class_id.tolist() == [0]
    assert second.class_id.tolist() == [0, 3]


def test_confidence_is_the_recorded_one_and_none_where_unknown() -> None:
    labels, _ = _one(_recorded([10, 10, 7, 10], confidence=[0.5, 2.0, 0.9, float("nan")]))
    assert labels.confidence.tolist() == [0.5, 1.0, 0.0, 0.0]


def test_without_recorded_confidence_the_model_is_taken_at_its_word() -> None:
    labels, _ = _one(_recorded([10, 7]))
    assert labels.confidence.tolist() == [1.0, 0.0]


def test_a_frame_without_recorded_labels_is_unknown_throughout() -> None:
    stream = Recorded()
    labels = list(stream([_posed(None, 3), _posed(_recorded([252]), 1, 1)]))
    assert labels[0].labels.tolist() == [UNKNOWN] * 3
    assert labels[0].confidence.tolist() == [0.0] * 3
    assert labels[1].labels.tolist() == [DYNAMIC]


def test_each_call_begins_anew() -> None:
    stream = Recorded()
    assert len(stream.class_names) == 0
    list(stream([_posed(_recorded([10]), 1)]))
    tram = {1: RecordedClass(name="tram", movable=True, moving=False)}
    list(stream([_posed(_recorded([1], classes=tram), 1)]))
    assert list(stream.class_names) == ["tram"]


def test_the_version_names_the_stream() -> None:
    assert Recorded().version.startswith("recorded@")
    assert Recorded().version == Recorded().version
