"""Recorded supervised stream: the answer of the on-board model, points or boxes, not networks."""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Confidences, Labels, Mask, MotionLabels
from schemas.frame import LidarFrame, PosedFrame, RecordedClass, RecordedLabels
from schemas.labels import FrameHealth, FrameLabels, MotionLabel
from schemas.task import GROUND, MOTION, Task
from workers.supervised.box_labels import NO_MOTION, BoxLabels
from workers.supervised.ground_classes import ground_labels_of

_REVISION: Final = b"recorded 2"
"""Revision of the code; increases when the same recorded labels give other labels."""

_LABEL_OF_CODE: Final = (MotionLabel.UNKNOWN, MotionLabel.STATIC, MotionLabel.DYNAMIC)
"""Labels of the recorded motion codes 0, 1, 2; any other code is unknown."""


class Recorded:
    """Labels of the car's own model, as recorded in the log.

    Recorded motion is used unchanged. Where only classes are recorded, a class that means moving is
    dynamic, any other known class static. Where no class means moving either, no motion is stated:
    a movable class is unknown, and the health of the frame states it. Boxes label the points in
    them (`box_labels`). Ground follows from the names of the classes. Frames without an answer are
    unknown throughout.

    Args:
        task: Task of the labels: motion, or ground.

    Attributes:
        task: Task of its labels.
    """

    def __init__(self, task: Task = MOTION) -> None:
        self.task = task
        self._answers = _ANSWERS[task.name]
        self._classes: dict[int | str, tuple[int, str]] = {}
        self._boxes = BoxLabels(self._classes)

    @property
    def version(self) -> str:
        """`name@digest`; the labels themselves belong to the log."""
        said = _REVISION if self.task == MOTION else _REVISION + self.task.name.encode()
        return f"recorded@{hashlib.sha256(said).hexdigest()[:12]}"

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names that `FrameLabels.class_id` indexes, ordered by the model's own id.

        Empty before the first labelled frame. Classes first declared by a later frame are appended,
        so that earlier indices stay valid.
        """
        return tuple(name for _, name in self._classes.values())

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the recorded labels of each frame, in order."""
        self._classes = {}
        self._boxes = BoxLabels(self._classes)
        for posed in frames:
            if posed.frame.boxes is not None and self.task == MOTION:
                yield self._boxes.label(posed, posed.frame.boxes)
                continue
            self._boxes.skip(posed)
            yield self._label(posed.frame)

    def _label(self, frame: LidarFrame) -> FrameLabels:
        recorded = frame.recorded
        if recorded is None:
            n = len(frame)
            return FrameLabels(
                labels=np.full(n, self.task.unknown, dtype=np.uint8),
                confidence=np.zeros(n, dtype=np.float16),
                class_id=np.full(n, -1, dtype=np.int16),
                health=FrameHealth(answered=False),
            )
        for class_id in sorted(recorded.classes):
            name = recorded.classes[class_id].name
            self._classes.setdefault(class_id, (len(self._classes), name))
        labels = self._answers(recorded)
        return FrameLabels(
            labels=labels,
            confidence=_confidence(recorded, labels, self.task),
            class_id=_per_id(
                recorded.class_id,
                {key: index for key, (index, _) in self._classes.items() if isinstance(key, int)},
                -1,
            ).astype(np.int16),
            health=FrameHealth(
                reason=NO_MOTION if self.task == MOTION and not says_motion(recorded) else ""
            ),
        )


def says_motion(recorded: RecordedLabels) -> bool:
    """Return True where labels state motion: in a field of its own, or by a class that moves."""
    classes = recorded.classes.values()
    return recorded.motion is not None or any(meaning.moving for meaning in classes)


def _motion(recorded: RecordedLabels) -> MotionLabels:
    if recorded.motion is not None:
        label_of_code = np.full(256, MotionLabel.UNKNOWN, dtype=np.uint8)
        label_of_code[: len(_LABEL_OF_CODE)] = _LABEL_OF_CODE
        return label_of_code[recorded.motion]
    known = recorded.classes
    told = says_motion(recorded)
    return _per_id(
        recorded.class_id,
        {key: _label_of(each) for key, each in known.items() if told or not each.movable},
        MotionLabel.UNKNOWN,
    ).astype(np.uint8)


def _ground(recorded: RecordedLabels) -> Labels:
    names = [meaning.name for meaning in recorded.classes.values()]
    told = zip(recorded.classes, ground_labels_of(names).tolist(), strict=True)
    return _per_id(recorded.class_id, dict(told), GROUND.unknown).astype(np.uint8)


_ANSWERS: Final[Mapping[str, Callable[[RecordedLabels], Labels]]] = {
    MOTION.name: _motion,
    GROUND.name: _ground,
}


def _label_of(meaning: RecordedClass) -> MotionLabel:
    return MotionLabel.DYNAMIC if meaning.moving else MotionLabel.STATIC


def _confidence(recorded: RecordedLabels, labels: Labels, task: Task) -> Confidences:
    known: Mask = np.not_equal(labels, task.unknown)
    if recorded.confidence is None:
        return known.astype(np.float16)
    sure: Confidences = np.zeros(len(labels), dtype=np.float16)
    sure[known] = np.clip(np.nan_to_num(recorded.confidence[known], nan=0.0), 0, 1)
    return sure


def _per_id(
    ids: NDArray[np.uint16], meaning: Mapping[int, int], otherwise: int
) -> NDArray[np.int32]:
    """Map every id; ids without meaning get `otherwise`."""
    table = np.full(np.iinfo(np.uint16).max + 1, otherwise, dtype=np.int32)
    for key, value in meaning.items():
        table[key] = value
    return table[ids]
