"""Right labels of a drive, from its truth: class and motion of each point, class of each object."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from schemas.arrays import Mask, Points
from workers.lab.evaluation.failures.planting.drive import DriveActor, DriveFrame
from workers.lab.evaluation.truth.class_table import COARSE, coarse_of_name
from workers.lab.evaluation.truth.truth import (
    TRUTH_DYNAMIC,
    TRUTH_STATIC,
    TRUTH_UNKNOWN,
    FrameTruth,
)
from workers.lab.simulation.models.kinds import MOVABLE, StreetClass

_NEAR_OBJECT_M: Final = 1.5
"""Distance from an object's points up to which a point without an object may belong to it, metres:
boxes of data sets lag behind fast objects by up to a metre.
"""

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


def whole_objects(
    true: FrameTruth,
    track: NDArray[np.int16],
    *,
    points_m: Points,
    class_id: NDArray[np.uint8],
    ground: Mask,
) -> NDArray[np.int16]:
    """Return the object of each point, with points that its box misses.

    A box that lags behind its object leaves a part of it outside, where truth does not judge. Such
    a point of a movable class belongs to the object of the nearest point of the same class.

    Args:
        true: Truth of the frame.
        track: (N,) object of each point by truth, -1 none.
        points_m: (N, 3) points in sensor space.
        class_id: (N,) right class, a `StreetClass`.
        ground: (N,) True on the ground.
    """
    track = track.copy()
    outside = (true.motion == TRUTH_UNKNOWN) & (track < 0) & ~ground
    for street_class in MOVABLE:
        loose = np.flatnonzero(outside & (class_id == street_class))
        inside = np.flatnonzero((track >= 0) & ~ground & (class_id == street_class))
        if not len(loose) or not len(inside):
            continue
        away_m, nearest = cKDTree(points_m[inside]).query(
            points_m[loose], distance_upper_bound=_NEAR_OBJECT_M
        )
        found = np.isfinite(away_m)
        track[loose[found]] = track[inside[nearest[found]]]
    return track


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
