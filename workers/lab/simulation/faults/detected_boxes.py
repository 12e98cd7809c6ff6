"""Boxes of a detector on simulated or real objects: errors of place, size, heading and velocity.

A body is an object in world space. Planted failures and noise change it before it is written as a
box in the space of the sensor.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lab.simulation.faults.faults import NORTH_EAST, PlantedFailure, TrueFrame
from workers.lab.simulation.faults.plan import FailureKind

_PLACE_M: Final = 0.06
_PLACE_PER_M: Final = 0.003
"""Standard deviation of a box's place: metres, and its growth per metre of range."""

SIZE_SHARE: Final = 0.05
_HEADING_RAD: Final = 0.035
_REVERSED_SHARE: Final = 0.01
"""Share of the boxes whose front and back are mistaken."""

_SPEED_M_PER_S: Final = 0.2
_STANDING_M_PER_S: Final = 0.08
"""Standard deviation of each component of the velocity, of movers and of standing objects."""

WRONG_M_PER_S: Final = (1.5, 5.0)
"""Speed of a box that stands and is reported as moving."""

NO_BOX: Final = frozenset(
    {
        FailureKind.UNSEEN_CLASS,
        FailureKind.MISSED_PEDESTRIAN,
        FailureKind.LATE_DETECTION,
        FailureKind.FLICKER,
    }
)
"""Failures by which an object has no box; other missed movers have a box that stands."""


@dataclass(frozen=True, slots=True)
class DetectedBox:
    """One box of a detector in one frame.

    Attributes:
        class_name: Class, by its name in the metadata record `counterpoint.classes`.
        centre_m: Centre of the box, sensor space at the time of the frame.
        yaw_rad: Heading around the sensor's z axis.
        size_m: Length, width and height.
        velocity_m_per_s: Velocity over the ground along the sensor's x and y axes.
        track_id: Id of the object, the same as long as the tracker follows it.
        score: Confidence, 0 to 1.
    """

    class_name: str
    centre_m: tuple[float, float, float]
    yaw_rad: float
    size_m: tuple[float, float, float]
    velocity_m_per_s: tuple[float, float]
    track_id: int
    score: float


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """An object in world space: centre, heading, size and velocity over the ground."""

    class_name: str
    centre_m: NDArray[np.float64]
    yaw_rad: float
    size_m: NDArray[np.float64]
    velocity: NDArray[np.float64]


def with_failures(
    track: int,
    body: Body,
    frame: TrueFrame,
    active: Sequence[PlantedFailure],
    *,
    moves: bool,
    no_box: Collection[FailureKind] = NO_BOX,
) -> Body | None:
    """Change a box by the failures on its object; None where there is no box.

    Args:
        track: Number of the object.
        body: Its box.
        frame: The frame.
        active: Failures of this instant.
        moves: Whether the object moves.
        no_box: Kinds by which an object has no box.
    """
    for each in active:
        ahead = np.array([np.cos(body.yaw_rad), np.sin(body.yaw_rad)])
        invented = (WRONG_M_PER_S[0] + track % 7 / 2) * ahead
        in_part = each.part < 1.0
        if each.kind is FailureKind.RANGE_LIMIT:
            away = body.centre_m[:2] - frame.world_from_sensor[:2, 3]
            if moves and np.hypot(*away) > each.range_m:
                return None
        elif track == each.other_track:
            body = replace(body, velocity=invented)
        elif track != each.track:
            continue
        elif each.kind is FailureKind.GHOST_MOVER and in_part:
            body = replace(_end_of(body, each.part, first=True), velocity=invented)
        elif each.kind in (FailureKind.PARKED_CALLED_MOVING, FailureKind.GHOST_MOVER):
            body = replace(body, velocity=invented)
        elif in_part:
            body = _end_of(body, 1.0 - each.part, first=False)
        elif each.kind in no_box:
            return None
        else:
            body = replace(body, velocity=np.zeros(2))
    return body


def _end_of(body: Body, share: float, *, first: bool) -> Body:
    """Return this share of a box, from the end that a failure in part begins with, or the other."""
    ahead = np.array([np.cos(body.yaw_rad), np.sin(body.yaw_rad)])
    rest = np.append(ahead * np.sign(ahead @ NORTH_EAST), 0.0)
    shift = rest * (body.size_m[0] * (1.0 - share) / 2)
    return replace(
        body,
        centre_m=body.centre_m + (-shift if first else shift),
        size_m=body.size_m * [share, 1.0, 1.0],
    )


def with_noise(
    body: Body,
    bias: NDArray[np.float64],
    frame: TrueFrame,
    noise: NDArray[np.float64],
    draw: float,
) -> Body:
    """Change a box by the errors of a detector.

    Args:
        body: The box.
        bias: (3,) lasting error of its size, as shares.
        frame: The frame; errors grow with the range.
        noise: (9,) standard normal values of the frame.
        draw: Uniform value; front and back are mistaken where it is low.
    """
    range_m = float(np.hypot(*(body.centre_m - frame.world_from_sensor[:3, 3])[:2]))
    place = (_PLACE_M + _PLACE_PER_M * range_m) * noise[:3] * [1.0, 1.0, 0.5]
    speed = float(np.hypot(*body.velocity))
    spread = _SPEED_M_PER_S if speed > 0.2 else _STANDING_M_PER_S
    turned = np.pi if draw < _REVERSED_SHARE else 0.0
    return Body(
        body.class_name,
        body.centre_m + place,
        body.yaw_rad + _HEADING_RAD * float(noise[3]) + turned,
        body.size_m * (1.0 + bias + 0.02 * noise[4]),
        body.velocity + spread * noise[5:7],
    )


def box_of(body: Body, frame: TrueFrame, track_id: int, score: float) -> DetectedBox:
    """Turn an object into sensor space."""
    rotation, origin = frame.world_from_sensor[:3, :3], frame.world_from_sensor[:3, 3]
    x, y, z = ((body.centre_m - origin) @ rotation).round(3).tolist()
    heading = rotation.T @ np.array([np.cos(body.yaw_rad), np.sin(body.yaw_rad), 0.0])
    vx, vy = (rotation.T @ np.array([*body.velocity, 0.0]))[:2].round(3).tolist()
    length, width, height = body.size_m.round(3).tolist()
    return DetectedBox(
        body.class_name,
        (x, y, z),
        round(float(np.arctan2(heading[1], heading[0])), 4),
        (length, width, height),
        (vx, vy),
        track_id,
        round(score, 3),
    )
