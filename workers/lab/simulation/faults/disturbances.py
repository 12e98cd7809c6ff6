"""Disturbances of the recording that are no failure of the model: its labels stay right.

All but the odometry slip change the sensor data. A log cannot contain a slip: the truth lists it,
and the failure benchmark injects it into the poses (`workers.lab.evaluation.failures.pose_slips`).
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Mask
from workers.lab.simulation.faults.plan import SCENE_S, DisturbanceKind, PlannedDisturbance
from workers.lab.simulation.sensor.lidar import SimulatedFrame

_JITTER_S: Final = 0.04
"""Largest delay of a stamp, seconds, as of an unsynchronised driver on a busy computer."""

_MAX_INTENSITY: Final = 255.0


@dataclass(frozen=True, slots=True)
class Disturbance:
    """One disturbance of one scene.

    Attributes:
        kind: Its kind.
        cell: Number of the scene in the log.
        start_s: Seconds from the start of the log.
        end_s: First instant after it.
        seed: Seed of what is drawn per frame.
        azimuth_rad: Middle of its sector.
        width_rad: Width of its sector.
        strength: Slip: radians per frame. Leak: metres. Intensity: a factor.
        shift_m: Slip: metres ahead per frame. Swapped sensor: metres upwards.
    """

    kind: DisturbanceKind
    cell: int
    start_s: float
    end_s: float
    seed: int
    azimuth_rad: float = 0.0
    width_rad: float = 0.0
    strength: float = 0.0
    shift_m: float = 0.0


def draw_disturbance(planned: PlannedDisturbance) -> Disturbance:
    """Draw the strength and place of a planned disturbance; a slip lasts a few frames only."""
    rng = np.random.default_rng([planned.seed, 0xD157])
    start_s, end_s = planned.cell * SCENE_S, (planned.cell + 1) * SCENE_S
    sign = 1.0 if rng.random() < 0.5 else -1.0
    drawn: dict[str, float] = {}
    if planned.kind is DisturbanceKind.ODOMETRY_SLIP:
        start_s += float(rng.uniform(0.3, 1.4))
        end_s = start_s + float(rng.uniform(0.2, 0.5))
        drawn["strength"] = sign * float(np.deg2rad(rng.uniform(0.3, 1.5)))
        drawn["shift_m"] = float(rng.uniform(-0.3, 0.3))
    elif planned.kind is DisturbanceKind.GROUND_LEAK:
        drawn["strength"] = float(rng.uniform(0.35, 0.6))
    elif planned.kind is DisturbanceKind.SENSOR_SWAP:
        drawn["strength"] = sign * float(np.deg2rad(rng.uniform(0.2, 0.6)))
        drawn["shift_m"] = float(rng.uniform(0.02, 0.06))
    elif planned.kind is DisturbanceKind.INTENSITY_SCALE:
        drawn["strength"] = float(rng.choice([0.2, 0.5, 2.0, 4.0]))
    if planned.kind in (DisturbanceKind.GROUND_LEAK, DisturbanceKind.DROPPED_SECTOR):
        drawn["azimuth_rad"] = float(rng.uniform(-np.pi, np.pi))
        drawn["width_rad"] = float(np.deg2rad(rng.uniform(40.0, 90.0)))
    return Disturbance(planned.kind, planned.cell, start_s, end_s, planned.seed, **drawn)


def disturb(frame: SimulatedFrame, disturbances: Iterable[Disturbance]) -> SimulatedFrame:
    """Apply the disturbances to a frame; the truth of each point moves with it."""
    for each in disturbances:
        if each.start_s <= frame.time_s < each.end_s:
            frame = _disturbed(frame, each)
    return frame


def delay_ns(index: int, time_s: float, disturbances: Iterable[Disturbance]) -> int:
    """Return the delay of a frame's stamp; 0 for the first of a log, by which scenes count."""
    jitters = [
        each
        for each in disturbances
        if each.kind is DisturbanceKind.TIME_JITTER and each.start_s <= time_s < each.end_s
    ]
    if not jitters or not index:
        return 0
    rng = np.random.default_rng([jitters[0].seed, index])
    return round(float(rng.uniform(0.0, _JITTER_S)) * NS_PER_S)


def only_points(frame: SimulatedFrame, kept: Mask) -> SimulatedFrame:
    """Keep some of the returns of a frame, in all of its arrays."""
    count = len(frame)
    arrays: dict[str, Any] = {}
    for each in fields(frame):
        value = getattr(frame, each.name)
        if isinstance(value, np.ndarray) and value.ndim and len(value) == count:
            arrays[each.name] = value[kept]
    arrays.pop("world_from_sensor", None)
    return replace(frame, **arrays)


def _disturbed(frame: SimulatedFrame, by: Disturbance) -> SimulatedFrame:
    if by.kind is DisturbanceKind.DROPPED_SECTOR:
        return only_points(frame, ~_in_sector(frame.points_m, by))
    if by.kind is DisturbanceKind.INTENSITY_SCALE:
        scaled = np.clip(np.round(frame.intensity * by.strength), 0.0, _MAX_INTENSITY)
        return replace(frame, intensity=scaled.astype(np.float32))
    if by.kind is DisturbanceKind.SENSOR_SWAP:
        half = only_points(frame, frame.ring % 2 == 0)
        cos, sin = np.cos(by.strength), np.sin(by.strength)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        points = half.points_m @ turn.T - np.array([0.0, 0.0, by.shift_m])
        return replace(half, points_m=points.astype(np.float32))
    if by.kind is DisturbanceKind.GROUND_LEAK:
        return _leaking(frame, by)
    return frame


def _leaking(frame: SimulatedFrame, by: Disturbance) -> SimulatedFrame:
    """Lift patches of the ground, different in every frame, as puddles and spray do."""
    rng = np.random.default_rng([by.seed, frame.index])
    points = frame.points_m.copy()
    patches = np.floor(points[:, :2] / 2.0).astype(np.int64)
    lifted = rng.random(1024) < 0.4
    patch = (patches[:, 0] * 31 + patches[:, 1] * 17) % 1024
    range_m = np.hypot(points[:, 0], points[:, 1])
    leaks = (frame.ground == 1) & _in_sector(points, by) & lifted[patch]
    leaks &= (range_m > 4.0) & (range_m < 25.0)
    points[leaks, 2] += np.abs(rng.normal(by.strength, 0.1, int(leaks.sum()))).astype(np.float32)
    return replace(frame, points_m=points)


def _in_sector(points_m: NDArray[np.float32], by: Disturbance) -> Mask:
    away = np.arctan2(points_m[:, 1], points_m[:, 0]) - by.azimuth_rad
    inside: Mask = np.abs((away + np.pi) % (2 * np.pi) - np.pi) < by.width_rad / 2
    return inside
