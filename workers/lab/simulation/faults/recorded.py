"""On-board model of the simulated car: true labels, except for planted failures and noise."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workers.lab.labels.borders import borders_of
from workers.lab.labels.noise import LabelNoise
from workers.lab.labels.noise_settings import SeenFrame
from workers.lab.simulation.faults.confidence import draw_border_confidence, draw_confidence
from workers.lab.simulation.faults.faults import PlantedFailure, corrupt
from workers.lab.simulation.models.kinds import MOVABLE, StreetClass
from workers.lab.simulation.sensor.lidar import SimulatedFrame
from workers.lab.simulation.world.street import Street


@dataclass(frozen=True, slots=True, eq=False)
class RecordedPoints:
    """Labels of the on-board model for each point of one frame, as written to the log.

    Attributes:
        label: (N,) class id.
        motion: (N,) 0 unknown, 1 static, 2 dynamic.
        confidence: (N,) 0 to 1.
    """

    label: NDArray[np.uint16]
    motion: NDArray[np.uint8]
    confidence: NDArray[np.float32]


def record(
    street: Street,
    frame: SimulatedFrame,
    failures: Sequence[PlantedFailure],
    *,
    noise: LabelNoise | None = None,
) -> RecordedPoints:
    """Return the labels of the on-board model for a frame.

    Args:
        street: Street of the log.
        frame: The frame as measured, disturbances included: labels stay right under those.
        failures: Failures planted in the log.
        noise: Noise of the labels of the drive, for frames in order; None for none.
    """
    motion = frame.motion.copy()
    label = frame.class_id.astype(np.uint16)
    corrupt(frame, motion, label, failures)
    steady = motion
    if noise is not None:
        motion, label = noise(_seen(frame), motion, label)
    wrong = motion != frame.motion
    thing = np.where(
        frame.track >= 0, frame.track, len(street.actors) + frame.class_id.astype(np.int64)
    )
    right_sure, wrong_sure = draw_confidence(
        seed=street.seed,
        things=len(street.actors) + 1 + max(StreetClass),
        time_s=frame.time_s,
        index=frame.index,
    )
    confidence = np.where(wrong, wrong_sure[thing], right_sure[thing])
    noisy = np.flatnonzero(motion != steady)
    if len(noisy):
        confidence[noisy] = draw_border_confidence(
            seed=street.seed, count=len(noisy), index=frame.index
        )
    return RecordedPoints(label, motion, confidence.round(3).astype(np.float32))


def noise_of(street: Street) -> LabelNoise:
    """Return the label noise of a drive; it is called for its frames in order."""
    return LabelNoise(seed=street.seed, blob_classes=tuple(int(each) for each in MOVABLE))


def _seen(frame: SimulatedFrame) -> SeenFrame:
    thing = frame.track.astype(np.int64)
    return SeenFrame(
        points_m=frame.points_m,
        thing=thing,
        ground=frame.ground == 1,
        world_from_sensor=frame.world_from_sensor,
        borders=borders_of(frame.points_m, thing),
    )


def recorded_classes() -> dict[str, str]:
    """Return the content of the metadata record `counterpoint.classes`: id to JSON."""
    return {
        str(int(c)): f'{{"name": "{c.name.lower()}", "movable": {str(c in MOVABLE).lower()}, '
        '"moving": false}'
        for c in StreetClass
    }
