"""Right labels of a drive, from its truth: class and motion of each point, class of each object."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask
from workers.lab.evaluation.failures.planting.drive import DriveActor, DriveFrame
from workers.lab.evaluation.truth.class_table import COARSE, coarse_of_name
from workers.lab.evaluation.truth.truth import (
    TRUTH_DYNAMIC,
    TRUTH_STATIC,
    TRUTH_UNKNOWN,
    FrameTruth,
)
from workers.lab.simulation.models.kinds import StreetClass

_STREET_CLASS: Final[dict[str, StreetClass]] = {
    "none": StreetClass.OBJECT,
    "car": StreetClass.CAR,
    "large_vehicle": StreetClass.TRUCK,
    "two_wheeler": StreetClass.CYCLIST,
    "pedestrian": StreetClass.PEDESTRIAN,
    "road": StreetClass.ROAD,
    "sidewalk": StreetClass.SIDEWALK,
    "other_ground": StreetClass.TERRAIN,
    "vegetation": StreetClass.VEGETATION,
    "building": StreetClass.BUILDING,
    "traffic_facility": StreetClass.POLE,
    "other_static": StreetClass.FENCE,
}
OF_COARSE: Final = np.array([_STREET_CLASS[name] for name in COARSE], dtype=np.uint8)
"""`StreetClass` of each coarse class of truth."""


def right_motion(true: FrameTruth, track: NDArray[np.int16], ground: Mask) -> NDArray[np.uint8]:
    """Return the labels of a model without errors, also where truth does not judge.

    There a point off the ground moves with the object it belongs to, and any other one is static.
    """
    motion = true.motion.copy()
    unknown = motion == TRUTH_UNKNOWN
    motion[unknown] = TRUTH_STATIC
    for each in np.unique(track[unknown & (track >= 0)]).tolist():
        mine = track == each
        counts = np.bincount(true.motion[mine], minlength=3)
        if counts[TRUTH_DYNAMIC] > counts[TRUTH_STATIC]:
            motion[mine & unknown & ~ground] = TRUTH_DYNAMIC
    return motion


def actors_of(frames: Sequence[DriveFrame]) -> tuple[DriveActor, ...]:
    """List the objects of a drive: class by truth's name, else by most of their points."""
    count = max(int(frame.track.max(initial=-1)) for frame in frames) + 1
    votes = np.zeros((count, 256), np.int64)
    sides = np.zeros(count)
    names: dict[int, str] = {}
    for frame in frames:
        mine = frame.track >= 0
        np.add.at(votes, (frame.track[mine], frame.class_id[mine]), 1)
        for track, thing in frame.truth.objects.items():
            names.setdefault(track, thing.class_name)
            if 0 <= track < count and thing.longest_side_m is not None:
                sides[track] = thing.longest_side_m
    votes[:, StreetClass.OBJECT] = np.minimum(votes[:, StreetClass.OBJECT], 1)
    actors = []
    for track in range(count):
        named = _STREET_CLASS[COARSE[coarse_of_name(names.get(track, ""))]]
        most = StreetClass(int(votes[track].argmax()) or StreetClass.OBJECT)
        which = most if named is StreetClass.OBJECT else named
        actors.append(DriveActor(which, (float(sides[track]), 0.0, 0.0)))
    return tuple(actors)
