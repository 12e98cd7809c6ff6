"""What made a scene's score, in words a reviewer reads at a glance."""

import math
from collections.abc import Sequence
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.attribution import Attribution, Wrong
from schemas.contradiction import Instance, Scene, SceneState
from schemas.frame import OdometryState
from schemas.score import OdometryHealth, StreamHealth
from schemas.task import Outcome, Task
from workers.contradiction.track_score import RankedTrack
from workers.contradiction.tracks import frame_period_s

MAX_REASONS: Final = 5
MAX_CLASS_LENGTH: Final = 24
WORTH_SAYING: Final = 0.05
"""Tracks below this strength are counted in the totals, not told."""

_SECTORS: Final = (
    "ahead",
    "ahead left",
    "left",
    "behind left",
    "behind",
    "behind right",
    "right",
    "ahead right",
)
_PROBABLY: Final = {
    Wrong.SUPERVISED: "the supervised stream errs",
    Wrong.SELFSUPERVISED: "the self-supervised stream errs",
    Wrong.BOTH: "both streams err",
    Wrong.NEITHER: "neither stream errs",
}


def reasons_of(
    scene: Scene,
    instances: Sequence[Instance],
    ranked: Sequence[RankedTrack],
    *,
    state: SceneState,
    health: OdometryHealth,
    stream: StreamHealth,
) -> tuple[str, ...]:
    """Say what made the score, strongest first; the state of a scene without one comes first.

    What held it down comes last: poses that were not trusted, frames in which the self-supervised
    stream judged nothing, so that nothing could contradict.
    """
    span_s = (scene.end_ns - scene.start_ns) / NS_PER_S
    because = f" ({health.reason})" if health.reason else ""
    if state is SceneState.TOO_SHORT:
        return (f"too short to judge: {len(scene.frames)} frames in {span_s:.1f} s",)
    if state is SceneState.ODOMETRY_LOST:
        return (f"odometry lost{because}: not judged",)
    told = tuple(
        describe(scene, instances, each)
        for each in ranked[:MAX_REASONS]
        if each.strength >= WORTH_SAYING
    )
    if health.state is not OdometryState.HEALTHY:
        doubted = 1.0 - health.healthy_share
        told += (
            f"odometry {health.state.value}{because} in {doubted:.0%} of the frames: what is "
            "seen there counts less",
        )
    told += tuple(remark for remark in [_remark(scene)] if remark)
    if stream.blind_share > 0.0:
        told += (_blind(stream),)
    if stream.blind_share < 1.0 and (silent := _nothing_compared(scene)):
        told += (silent,)
    return told


def _nothing_compared(scene: Scene) -> str:
    """Say who was silent where no point was compared; empty where one was."""
    unknown = scene.task.unknown
    if any((frame.agreements != scene.task.not_compared).any() for frame in scene.frames):
        return ""
    silent = [
        name
        for name, said in (
            ("supervised", [frame.semantic for frame in scene.frames]),
            ("self-supervised", [frame.predictive for frame in scene.frames]),
        )
        if all((labels.labels == unknown).all() for labels in said)
    ]
    if not silent:
        return "nothing was compared: no point was judged by both streams"
    return f"nothing was compared: the {' and the '.join(silent)} stream judged no point"


def _remark(scene: Scene) -> str:
    """What was said of the poses beside whether they may be trusted, once; empty for nothing."""
    return next((frame.posed.remark for frame in scene.frames if frame.posed.remark), "")


def _blind(stream: StreamHealth) -> str:
    because = f" ({stream.reason})" if stream.reason else ""
    if stream.blind_share < 1.0:
        return f"self-supervised stream blind in {stream.blind_share:.0%} of the frames{because}"
    return f"self-supervised stream blind throughout{because}: nothing was compared"


def describe(scene: Scene, instances: Sequence[Instance], ranked: RankedTrack) -> str:
    """Tell one track: what, who says what of it, how long, how fast, where."""
    members = ranked.track.members
    first, last = (scene.frames[instances[m].frame_index] for m in (members[0], members[-1]))
    seen_s = (last.stamp_ns - first.stamp_ns) / NS_PER_S + frame_period_s(scene)
    x_m, y_m = (float(value) for value in instances[ranked.strongest].centre_m[:2])
    once = ", never confirmed" if ranked.confirmed_share == 0.0 else ""
    moving = f" at {ranked.speed_m_per_s:.1f} m/s" if ranked.speed_m_per_s >= 0.5 else ""
    return (
        f"{class_word(ranked.class_name) or 'object'} "
        f"{_claim(ranked.track.kind, scene.task, moving)} for {seen_s:.1f} s{once}, "
        f"{math.hypot(x_m, y_m):.0f} m {bearing(x_m, y_m)}{_blame(ranked.attribution)}"
    )


def _claim(kind: Outcome, task: Task, moving: str) -> str:
    if kind.of_witness:
        return f"seen moving{moving} by the witness alone"
    if task.moving and (kind.semantic == task.moving or kind.measured):
        stream = "self-supervised" if kind.measured else "supervised"
        return f"seen moving{moving} by the {stream} stream alone"
    return (
        f"called {kind.semantic} by the supervised and {kind.predictive} by the self-supervised "
        "stream"
    )


def _blame(attribution: Attribution | None) -> str:
    """Who probably errs, how sure that is, and what speaks for and against it."""
    if attribution is None:
        return ""
    known = (
        ("for", attribution.because),
        ("against", attribution.against),
        ("also", attribution.also),
    )
    why = "".join(f"; {how}: {', '.join(words)}" for how, words in known if words)
    return f"; {_PROBABLY[attribution.wrong]} ({attribution.chance:.0%}{why})"


def bearing(x_m: float, y_m: float) -> str:
    """Name the direction of a place in sensor space (x forward, y left), in eighths."""
    return _SECTORS[round(math.atan2(y_m, x_m) / (math.pi / 4)) % 8]


def class_word(name: str) -> str:
    """Shorten a class name, which a recorded model may choose at will, to what a record holds."""
    printable = "".join(c if c.isascii() and c.isprintable() else "?" for c in name)
    return (
        printable if len(printable) <= MAX_CLASS_LENGTH else printable[: MAX_CLASS_LENGTH - 1] + "~"
    )
