"""Track association: the same contradicting object followed over the frames of a scene."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from schemas.arrays import NS_PER_S
from schemas.contradiction import Instance, Scene
from schemas.task import Outcome
from workers.contradiction.settings import DEFAULT_TRACKS, TrackSettings

_TOO_FAR: Final = 1_000.0
"""Cost of a pair outside the gate: above any sum of matches, so that it replaces none."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One contradicting object over the frames of a scene.

    Attributes:
        kind: Kind of contradiction.
        members: Indices into the scene's instances, in the order of their frames.
        centres_m: (len(members), 3) box centres, odom space, metres.
    """

    kind: Outcome
    members: tuple[int, ...]
    centres_m: NDArray[np.float64]


@dataclass(slots=True, eq=False)
class _Open:
    """A track that may still be extended."""

    kind: Outcome
    members: list[int]
    centres_m: list[NDArray[np.float64]]
    stamps_s: list[float]
    lengths_m: list[float]
    longest_m: float = 0.0
    velocity_m_per_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    speed_known: bool = False

    def predicted_m(self, stamp_s: float) -> NDArray[np.float64]:
        return self.centres_m[-1] + self.velocity_m_per_s * (stamp_s - self.stamps_s[-1])


def centres_in_odom(scene: Scene, instances: Sequence[Instance]) -> NDArray[np.float64]:
    """Return the box centres of all instances in odom space.

    Returns:
        (len(instances), 3) metres.
    """
    centres_m = np.zeros((len(instances), 3))
    for i, instance in enumerate(instances):
        pose = scene.frames[instance.frame_index].posed.odom_from_sensor
        centres_m[i] = pose[:3, :3] @ instance.centre_m + pose[:3, 3]
    return centres_m


def associate_instances(
    scene: Scene, instances: Sequence[Instance], *, settings: TrackSettings = DEFAULT_TRACKS
) -> tuple[Track, ...]:
    """Associate instances of one kind over frames by their predicted places.

    The Hungarian method matches each frame's instances to the open tracks. The cost is the distance
    to the predicted place over the gate, plus the difference of lengths: an object that is half
    hidden for a moment continues as its larger part. A track may be unobserved for `max_miss_s`, or
    for one frame of a slow sensor. Places are in odom space, where a parked object does not move.

    Args:
        scene: Scene of the instances.
        instances: Instances of `find_instances`, by frame.
        settings: Gates, per second.

    Returns:
        Every instance in exactly one track; tracks by their first instance.
    """
    stamps_s = [(frame.stamp_ns - scene.start_ns) / NS_PER_S for frame in scene.frames]
    period_s = frame_period_s(scene)
    max_gap_s = longest_gap_s(period_s, settings)
    centres_m = centres_in_odom(scene, instances)
    found: dict[tuple[str, int], list[int]] = {}
    for i, instance in enumerate(instances):
        found.setdefault((instance.kind.name, instance.frame_index), []).append(i)
    done: list[_Open] = []
    for kind in scene.task.kinds:
        going: list[_Open] = []
        for frame_index, stamp_s in enumerate(stamps_s):
            still = [t for t in going if stamp_s - t.stamps_s[-1] <= max_gap_s]
            done.extend(t for t in going if stamp_s - t.stamps_s[-1] > max_gap_s)
            going = still
            new = found.get((kind.name, frame_index), [])
            matched = _match(going, new, instances, centres_m, stamp_s, settings)
            for track, i in matched:
                _extend(track, i, instances[i], centres_m[i], stamp_s, settings)
            taken = {i for _, i in matched}
            going.extend(
                _begin(i, instances[i], centres_m[i], stamp_s) for i in new if i not in taken
            )
        done.extend(going)
    done.sort(key=lambda track: track.members[0])
    return tuple(
        Track(kind=t.kind, members=tuple(t.members), centres_m=np.stack(t.centres_m)) for t in done
    )


def frame_period_s(scene: Scene) -> float:
    """Return the median time between the frames of a scene; 0 for a single frame."""
    stamps_ns = np.array([frame.stamp_ns for frame in scene.frames], dtype=np.int64)
    return float(np.median(np.diff(stamps_ns))) / NS_PER_S if len(stamps_ns) > 1 else 0.0


def _match(
    going: Sequence[_Open],
    new: Sequence[int],
    instances: Sequence[Instance],
    centres_m: NDArray[np.float64],
    stamp_s: float,
    settings: TrackSettings,
) -> list[tuple[_Open, int]]:
    if not going or not new:
        return []
    predicted_m = np.stack([track.predicted_m(stamp_s) for track in going])
    distance_m = np.linalg.norm(predicted_m[:, None, :2] - centres_m[None, list(new), :2], axis=2)
    gate_m = np.array(
        [[_gate_m(track, instances[i], stamp_s, settings) for i in new] for track in going]
    )
    lengths_m = np.array([instances[i].size_m[0] for i in new])
    before_m = np.array([track.longest_m for track in going])
    shorter_m = np.minimum(before_m[:, None], lengths_m[None])
    longer_m = np.maximum(np.maximum(before_m[:, None], lengths_m[None]), 0.1)
    unlike = settings.unlike_cost * (1.0 - shorter_m / longer_m)
    within = distance_m <= gate_m
    cost = np.where(within, np.round(distance_m / gate_m + unlike, 6), _TOO_FAR)
    rows, columns = linear_sum_assignment(cost)
    return [
        (going[row], new[column])
        for row, column in zip(rows, columns, strict=True)
        if within[row, column]
    ]


def longest_gap_s(period_s: float, settings: TrackSettings) -> float:
    """Return the longest gap in a track: `max_miss_s` or one frame period, plus half a period."""
    return max(settings.max_miss_s, period_s) + 0.5 * period_s


def _gate_m(track: _Open, instance: Instance, stamp_s: float, settings: TrackSettings) -> float:
    gap_s = stamp_s - track.stamps_s[-1]
    length_m = max(track.longest_m, float(instance.size_m[0]))
    gate_m = (
        settings.gate_m
        + settings.gate_per_length * length_m
        + settings.acceleration_m_per_s2 * gap_s**2 / 2
        + (0.0 if track.speed_known else settings.unseen_speed_m_per_s * gap_s)
    )
    return min(gate_m, settings.max_gate_m)


def _begin(i: int, instance: Instance, centre_m: NDArray[np.float64], stamp_s: float) -> _Open:
    length_m = float(instance.size_m[0])
    track = _Open(instance.kind, [i], [centre_m], [stamp_s], [length_m], length_m)
    _measure(track, instance)
    return track


def _extend(
    track: _Open,
    i: int,
    instance: Instance,
    centre_m: NDArray[np.float64],
    stamp_s: float,
    settings: TrackSettings,
) -> None:
    track.members.append(i)
    track.centres_m.append(centre_m)
    track.stamps_s.append(stamp_s)
    track.lengths_m.append(float(instance.size_m[0]))
    track.longest_m = max(track.lengths_m)
    if _measure(track, instance):
        return
    # No stream measured it: its own path over up to a second gives its velocity.
    start = next(j for j, at_s in enumerate(track.stamps_s) if stamp_s - at_s <= 1.0)
    span_s = stamp_s - track.stamps_s[start]
    if span_s > 0:
        velocity = (centre_m - track.centres_m[start]) / span_s
        speed = float(np.linalg.norm(velocity))
        track.velocity_m_per_s = velocity * min(1.0, settings.max_speed_m_per_s / (speed + 1e-9))
        track.speed_known = span_s >= 0.3


def _measure(track: _Open, instance: Instance) -> bool:
    """Adopt the measured velocity, if any; a stream that labels static measures none."""
    measured = instance.kind.measured and bool(np.any(instance.velocity_m_per_s))
    if measured:
        track.velocity_m_per_s = instance.velocity_m_per_s
        track.speed_known = True
    return measured
