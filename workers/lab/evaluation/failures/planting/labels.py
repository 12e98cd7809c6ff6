"""Recorded labels of a variant: right labels, planted failures, then noise."""

from collections.abc import Iterator, Sequence

import numpy as np

from schemas.frame import RecordedClass, RecordedLabels
from workers.lab.evaluation.failures.planting.drive import Drive
from workers.lab.evaluation.failures.planting.variants import Variant
from workers.lab.labels.noise import LabelNoise
from workers.lab.simulation.faults.confidence import draw_confidence
from workers.lab.simulation.faults.faults import PlantedFailure, corrupt
from workers.lab.simulation.models.kinds import MOVABLE, StreetClass

CLASSES = {
    int(each): RecordedClass(each.name.lower(), movable=each in MOVABLE, moving=False)
    for each in StreetClass
}
"""Meaning of the class ids of the labels, those of a simulated log."""

_BLOB_CLASSES = tuple(
    int(each)
    for each in (StreetClass.CAR, StreetClass.TRUCK, StreetClass.PEDESTRIAN, StreetClass.CYCLIST)
)


def labels_of_variant(
    drive: Drive, variant: Variant, failures: Sequence[PlantedFailure]
) -> Iterator[RecordedLabels]:
    """Yield the labels of each frame of a drive, as the model on the car would record them."""
    noise = LabelNoise(variant.seed, _BLOB_CLASSES, variant.noise)
    for frame in drive.frames:
        motion, label = frame.motion.copy(), frame.class_id.astype(np.uint16)
        corrupt(frame, motion, label, failures)
        motion, label = noise(frame.seen, motion, label)
        wrong = motion != frame.motion
        thing = np.where(
            frame.track >= 0, frame.track, len(drive.actors) + frame.class_id.astype(np.int64)
        )
        right_sure, wrong_sure = draw_confidence(
            seed=variant.seed,
            things=len(drive.actors) + 1 + max(StreetClass),
            time_s=frame.time_s,
            index=frame.index,
        )
        confidence = np.where(wrong, wrong_sure[thing], right_sure[thing]).round(3)
        yield RecordedLabels(label, motion, confidence.astype(np.float32), CLASSES)
