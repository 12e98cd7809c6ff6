"""A detector's output made from true boxes, with the errors that detectors make, by a seed.

Boxes have noise in place, size, heading and velocity; objects of few points flicker; tracks start
late. Failures are planted on top: movers that are missed for a second and more, ghosts that drive
where nothing is, and movers whose velocity the detector states as zero.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from tests.box_messages import Box
from workers.points.se3 import inverse

CLASSES: Final = {
    "Pedestrian with Object": "pedestrian",
    "Pedestrian": "pedestrian",
    "Motorcycle": "motorcycle",
    "Medium-sized Truck": "truck",
    "Pickup Truck": "car",
    "Towed Object": "trailer",
    "Other Vehicle - Construction Vehicle": "truck",
}
"""Class of PandaSet to the class of the detector; cones become hazards, all others cars."""

MIN_POINTS: Final = 5
PLANTED_POINTS: Final = 20
"""Points of a mover from which a detector should see it, and a miss is planted."""

GHOST_FRAMES: Final = 14


@dataclass(frozen=True)
class TrueBox:
    """One true box of one frame, in the map."""

    frame: int
    track_id: int
    class_name: str
    centre_m: NDArray[np.float64]
    size_m: tuple[float, float, float]
    yaw_rad: float
    velocity: NDArray[np.float64]
    speed: float
    moving: bool
    points: int


@dataclass(frozen=True)
class Planted:
    """One planted failure: what, of which track, in which frames."""

    kind: str
    track_id: int
    first: int
    last: int


@dataclass(frozen=True)
class Truth:
    """True boxes and poses of a log."""

    boxes: Mapping[int, Sequence[TrueBox]]
    stamp_ns: NDArray[np.int64]
    reference_ns: NDArray[np.int64]
    map_from_lidar: NDArray[np.float64]

    def pose(self, time_ns: float) -> NDArray[np.float64]:
        """Interpolate the pose of the lidar in the map, held at both ends."""
        times = self.reference_ns
        time_ns = float(np.clip(time_ns, times[0], times[-1]))
        after = int(np.clip(np.searchsorted(times, time_ns), 1, len(times) - 1))
        share = (time_ns - times[after - 1]) / (times[after] - times[after - 1])
        ends = self.map_from_lidar[after - 1 : after + 1]
        placed = np.eye(4)
        placed[:3, :3] = Slerp([0, 1], Rotation.from_matrix(ends[:, :3, :3]))(share).as_matrix()
        placed[:3, 3] = (1 - share) * ends[0, :3, 3] + share * ends[1, :3, 3]
        return placed


def read_truth(folder: Path) -> Truth:
    """Read `tracks.csv` and `poses.npz` of a log in the form of TRUTH.md."""
    boxes: dict[int, list[TrueBox]] = {}
    with (folder / "tracks.csv").open() as file:
        for row in csv.DictReader(file):
            number: dict[str, float] = {
                name: float(row[name]) for name in ("x", "y", "z", "vx", "vy", "vz", "yaw")
            }
            boxes.setdefault(int(row["frame"]), []).append(
                TrueBox(
                    frame=int(row["frame"]),
                    track_id=int(row["track_id"]),
                    class_name=_class(row["class"]),
                    centre_m=np.array([number["x"], number["y"], number["z"]]),
                    size_m=(float(row["length"]), float(row["width"]), float(row["height"])),
                    yaw_rad=number["yaw"],
                    velocity=np.array([number["vx"], number["vy"], number["vz"]]),
                    speed=float(row["speed"]),
                    moving=row["moving"] == "1",
                    points=int(row["points_inside"]),
                )
            )
    poses = np.load(folder / "poses.npz")
    return Truth(
        boxes,
        poses["stamp_ns"],
        poses["reference_time_ns"],
        poses["world_from_lidar_at_reference"],
    )


def _class(name: str) -> str:
    return "hazard" if name == "Cones" else CLASSES.get(name, "car")


def plant(truth: Truth, rng: np.random.Generator, frames: range) -> list[Planted]:
    """Choose failures: movers that are missed, movers stated to stand, and ghosts."""
    seen: dict[int, list[int]] = {}
    for frame in frames:
        for box in truth.boxes[frame]:
            if box.moving and box.points >= PLANTED_POINTS and box.speed > 1.0:
                seen.setdefault(box.track_id, []).append(frame)
    long = sorted(track_id for track_id, at in seen.items() if len(at) >= GHOST_FRAMES)
    chosen = rng.permutation(long)[:5].tolist()
    planted = []
    for number, track_id in enumerate(chosen):
        kind = "missed" if number < 3 else "stands"
        at = seen[track_id]
        start = int(rng.integers(0, len(at) - GHOST_FRAMES + 1))
        planted.append(Planted(kind, track_id, at[start], at[start + GHOST_FRAMES - 1]))
    for number in range(2):
        first = int(rng.integers(frames.start, frames.stop - GHOST_FRAMES))
        planted.append(Planted("ghost", 9_000 + number, first, first + GHOST_FRAMES - 1))
    return planted


def detector_boxes(
    truth: Truth, planted: Sequence[Planted], rng: np.random.Generator
) -> dict[int, list[Box]]:
    """Make the detector's boxes of every frame, in the map, each when the beam met it."""
    late = {box.track_id: int(rng.integers(0, 4)) for at in truth.boxes.values() for box in at}
    first_seen: dict[int, int] = {}
    found: dict[int, list[Box]] = {}
    for frame in sorted(truth.boxes):
        found[frame] = []
        for box in truth.boxes[frame]:
            if box.points < MIN_POINTS:
                continue
            first_seen.setdefault(box.track_id, frame)
            started = frame - first_seen[box.track_id] >= late[box.track_id]
            flickers = rng.random() < 0.25 * np.exp(-box.points / 15.0)
            hit = {p.kind for p in planted if _concerns(p, box.track_id, frame)}
            made = _noisy(box, rng, stands="stands" in hit)
            if (started or frame < 3) and not flickers and "missed" not in hit:
                found[frame].append(made)
    for ghost in (each for each in planted if each.kind == "ghost"):
        for frame, made in _ghost(truth, ghost, rng):
            found[frame].append(made)
    return found


def in_space(boxes: Sequence[Box], to_from_map: NDArray[np.float64]) -> list[Box]:
    """Return boxes of the map in another space."""
    turn = float(np.arctan2(to_from_map[1, 0], to_from_map[0, 0]))
    return [
        replace(
            box,
            centre_m=_triple(to_from_map[:3, :3] @ np.array(box.centre_m) + to_from_map[:3, 3]),
            yaw_rad=box.yaw_rad + turn,
            velocity_m_per_s=None
            if box.velocity_m_per_s is None
            else _triple(to_from_map[:3, :3] @ np.array(box.velocity_m_per_s)),
        )
        for box in boxes
    ]


def in_cloud(truth: Truth, boxes: Sequence[Box], frame: int) -> list[Box]:
    """Return boxes as found in a cloud that is not deskewed: each where the beam met it."""
    return [in_space([box], inverse(truth.pose(_seen_ns(truth, box, frame))))[0] for box in boxes]


def at_instant(truth: Truth, boxes: Sequence[Box], frame: int, stamp_ns: int) -> list[Box]:
    """Return boxes of the map at one instant, moved by their velocities since they were seen."""
    moved = []
    for box in boxes:
        later_s = (stamp_ns - _seen_ns(truth, box, frame)) * 1e-9
        velocity = np.array(box.velocity_m_per_s or (0.0, 0.0, 0.0))
        moved.append(replace(box, centre_m=_triple(np.array(box.centre_m) + velocity * later_s)))
    return moved


def _seen_ns(truth: Truth, box: Box, frame: int) -> float:
    """Return when the beam met a box: truth has each box where the points of its sweep were."""
    seen_ns = float(truth.stamp_ns[frame]) + 5e7
    for _ in range(2):
        x, y, _z = (
            inverse(truth.pose(seen_ns))[:3, :3] @ np.array(box.centre_m)
            + inverse(truth.pose(seen_ns))[:3, 3]
        )
        share = ((-178.0 - float(np.degrees(np.arctan2(y, x)))) % 360.0) / 360.0
        seen_ns = float(truth.stamp_ns[frame]) + share * 1e8  # clockwise from behind
    return seen_ns


def _concerns(planted: Planted, track_id: int, frame: int) -> bool:
    return planted.track_id == track_id and planted.first <= frame <= planted.last


def _noisy(box: TrueBox, rng: np.random.Generator, *, stands: bool) -> Box:
    size = np.array(box.size_m) * (1 + rng.normal(0, 0.04, 3))
    velocity = box.velocity + np.append(rng.normal(0, 0.12, 2), 0.0)
    if stands:
        velocity = np.zeros(3)
    return Box(
        centre_m=_triple(box.centre_m + rng.normal(0, (0.08, 0.08, 0.05))),
        size_m=_triple(size),
        yaw_rad=box.yaw_rad + float(rng.normal(0, 0.03)),
        velocity_m_per_s=_triple(velocity),
        score=float(np.clip(rng.beta(8, 2) * (1 - np.exp(-box.points / 20)), 0.05, 1.0)),
        class_name=box.class_name,
        track_id=f"t{box.track_id}",
    )


def _ghost(truth: Truth, planted: Planted, rng: np.random.Generator) -> list[tuple[int, Box]]:
    """Let a box drive along what stands: over parked cars, at 5 m/s."""
    parked = [
        box
        for box in truth.boxes[planted.first]
        if not box.moving and box.points > 200 and box.class_name == "car"
    ]
    start = parked[int(rng.integers(len(parked)))]
    along = np.array([np.cos(start.yaw_rad), np.sin(start.yaw_rad), 0.0])
    speed = 5.0
    made = []
    for number, frame in enumerate(range(planted.first, planted.last + 1)):
        centre = start.centre_m + along * speed * (0.1 * number - 0.7)
        box = Box(
            centre_m=_triple(centre + rng.normal(0, 0.08, 3)),
            size_m=start.size_m,
            yaw_rad=start.yaw_rad,
            velocity_m_per_s=_triple(along * speed),
            score=0.6,
            track_id=f"t{planted.track_id}",
        )
        made.append((frame, box))
    return made


def _triple(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
