"""Reasons of a score: a headline per track with its evidence, then what lowered the score."""

import math
from collections.abc import Sequence
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.attribution import Attribution, Wrong
from schemas.contradiction import Instance, Scene, SceneState
from schemas.frame import OdometryState
from schemas.score import (
    MAX_OPPOSING,
    MAX_SUPPORTING,
    MIN_REPORTED_STRENGTH,
    Reason,
    StreamHealth,
    SupervisedHealth,
)
from schemas.task import Outcome, Task
from workers.contradiction.explanations import HALF
from workers.contradiction.scene_statistics import SceneStatistics
from workers.contradiction.track_score import RankedTrack
from workers.contradiction.tracks import frame_period_s

MAX_REASONS: Final = 5
MAX_CLASS_LENGTH: Final = 24
SUPERVISED: Final = "supervised"
SELFSUPERVISED: Final = "self-supervised"
WITNESS: Final = "witness"

TAUGHT_REMARK: Final = (
    "the supervised stream was taught by the self-supervised stream: it is no independent critic "
    "of motion, and no contradiction is attributed"
)
"""Remark of every scored scene that weights of `counterpoint adapt` labelled."""

_MIN_SPEED_M_PER_S: Final = 0.5
"""Speed below which a headline gives no number."""

_SECTORS: Final = (
    "ahead",
    "ahead to the left",
    "to the left",
    "behind to the left",
    "behind",
    "behind to the right",
    "to the right",
    "ahead to the right",
)


def reasons_of(
    scene: Scene,
    instances: Sequence[Instance],
    ranked: Sequence[RankedTrack],
    *,
    state: SceneState,
    statistics: SceneStatistics,
    own_model: str = "",
    taught: bool = False,
) -> tuple[Reason, ...]:
    """Return the reasons of a score, strongest first.

    The state of a scene without a score comes first. What lowered a score comes last: that nothing
    was compared, poses that were doubted, and frames without a label of the self-supervised stream.

    Args:
        scene: The scene.
        instances: Its instances.
        ranked: Its tracks, strongest first.
        state: State of its score.
        statistics: Statistics of the scene.
        own_model: Name of the user's own model; empty: the supervised stream is a shipped one.
        taught: The supervised stream was taught by the self-supervised one, which the last reason
            says.
    """
    health, stream = statistics.odometry, statistics.stream
    span_s = (scene.end_ns - scene.start_ns) / NS_PER_S
    cause = f" ({health.reason})" if health.reason else ""
    if state is SceneState.TOO_SHORT:
        short = f"too short to judge: {len(scene.frames)} frames in {span_s:.1f} s"
        return (Reason(headline=short),)
    if state is SceneState.ODOMETRY_LOST:
        return (Reason(headline=f"odometry lost{cause}: not judged"),)
    reasons = [
        reason_of(scene, instances, each, track_id=track_id, own_model=own_model)
        for track_id, each in enumerate(ranked[:MAX_REASONS])
        if each.strength >= MIN_REPORTED_STRENGTH
    ]
    lowered = [] if stream.blind_share == 1.0 else [_nothing_compared(statistics)]
    if health.state is not OdometryState.HEALTHY:
        doubted = 1.0 - health.healthy_share
        lowered.append(
            f"odometry {health.state.value}{cause} in {doubted:.0%} of the frames, which have a "
            "lower weight"
        )
    lowered.append(statistics.remark)
    if stream.blind_share > 0.0:
        lowered.append(_blind(stream))
    lowered += open_questions(statistics.supervised)
    if taught:
        lowered.append(TAUGHT_REMARK)
    return (*reasons, *(Reason(headline=each) for each in lowered if each))


def reason_of(
    scene: Scene,
    instances: Sequence[Instance],
    ranked: RankedTrack,
    *,
    track_id: int,
    own_model: str = "",
) -> Reason:
    """Return the reason for one track: its headline, and the strongest evidence.

    Args:
        scene: The scene.
        instances: Its instances.
        ranked: The track.
        track_id: Number of the track within the scene.
        own_model: Name of the user's own model, or empty.
    """
    attribution = ranked.attribution
    return Reason(
        headline=headline_of(scene, instances, ranked, own_model=own_model),
        track_id=track_id,
        supporting=attribution.supporting[:MAX_SUPPORTING] if attribution else (),
        opposing=attribution.opposing[:MAX_OPPOSING] if attribution else (),
    )


def headline_of(
    scene: Scene, instances: Sequence[Instance], ranked: RankedTrack, *, own_model: str = ""
) -> str:
    """Return labels, place, duration and attribution of a track on one line.

    It states what the sources label and measure, never as a fact what is only an attribution. For
    example "supervised labels car static, but self-supervised measures 6.5 m/s, 10 m behind, for
    1.4 s: supervised wrong, 96 %".
    """
    members = ranked.track.members
    first, last = (scene.frames[instances[m].frame_index] for m in (members[0], members[-1]))
    duration_s = (last.stamp_ns - first.stamp_ns) / NS_PER_S + frame_period_s(scene)
    x_m, y_m = (float(value) for value in instances[ranked.strongest].centre_m[:2])
    supervised = own_model or SUPERVISED
    in_boxes = first.posed.frame.boxes is not None
    claim = _claim(ranked, scene.task, supervised, in_boxes=in_boxes)
    return (
        f"{claim}, {math.hypot(x_m, y_m):.0f} m {bearing(x_m, y_m)}, for {duration_s:.1f} s"
        f"{_attributed(ranked.track.kind, ranked.attribution, supervised)}"
    )


def _claim(ranked: RankedTrack, task: Task, supervised: str, *, in_boxes: bool) -> str:
    """Return the label that is probably wrong, and what another source labels or measures.

    A model that answers in boxes has none around what it gives no class.
    """
    kind, attribution = ranked.track.kind, ranked.attribution
    wrong = attribution.wrong if attribution is not None else Wrong.NEITHER
    sources = ((supervised, kind.semantic), (SELFSUPERVISED, kind.predictive))
    if kind.of_witness:
        (source, label), (other, seen) = sources[0], (f"the {WITNESS}", task.moving)
    elif wrong is Wrong.SELFSUPERVISED:
        (other, seen), (source, label) = sources
    else:
        (source, label), (other, seen) = sources
    contrary = _contrary(ranked, task, other, seen)
    class_name = class_word(ranked.class_name)
    if in_boxes and not class_name and source == supervised:
        return f"{source} has no box there, but {contrary}"
    return f"{source} labels {class_name or 'object'} {label}, but {contrary}"


def _contrary(ranked: RankedTrack, task: Task, other: str, seen: str) -> str:
    """Return what contradicts a label: a shape in its place, a speed, or the other label."""
    speed_m_per_s = ranked.speed_m_per_s
    if task.moving and seen != task.moving and ranked.features.shape_static > HALF:
        return "its shape stays in place"
    if other == SELFSUPERVISED and seen == task.moving and speed_m_per_s >= _MIN_SPEED_M_PER_S:
        return f"{other} measures {speed_m_per_s:.1f} m/s"
    return f"{other} labels it {seen}"


def _attributed(kind: Outcome, attribution: Attribution | None, supervised: str) -> str:
    if attribution is None:
        return ""
    wrong = {
        Wrong.SUPERVISED: f"{supervised} wrong",
        Wrong.SELFSUPERVISED: f"{SELFSUPERVISED} wrong",
        Wrong.BOTH: "both wrong",
        Wrong.NEITHER: f"{WITNESS} wrong" if kind.of_witness else "neither wrong",
    }[attribution.wrong]
    return f": {wrong}, {100 * attribution.chance:.0f} %"


def _nothing_compared(statistics: SceneStatistics) -> str:
    """Return why no point was compared; empty where one was."""
    if statistics.compared:
        return ""
    silent = [
        name
        for name, is_silent in (
            (SUPERVISED, statistics.supervised_silent),
            (SELFSUPERVISED, statistics.selfsupervised_silent),
        )
        if is_silent
    ]
    if not silent:
        return "nothing was compared: no point was labelled by both streams"
    return f"nothing was compared: the {' and the '.join(silent)} stream labelled no point"


def _blind(stream: StreamHealth) -> str:
    cause = f" ({stream.reason})" if stream.reason else ""
    if stream.blind_share < 1.0:
        return f"self-supervised stream blind in {stream.blind_share:.0%} of the frames{cause}"
    return f"self-supervised stream blind throughout{cause}: nothing was compared"


def open_questions(supervised: SupervisedHealth | None) -> list[str]:
    """Return what the supervised stream leaves open, in a sentence each."""
    if supervised is None:
        return []
    found = []
    if supervised.reason:
        share = f"{supervised.labelled_share:.0%} of the returns can contradict"
        found.append(f"{supervised.reason}; {share}")
    if supervised.unanswered_share:
        found.append(
            f"the model gave no answer in {supervised.unanswered_share:.0%} of the frames, which "
            "are not judged"
        )
    return found


def bearing(x_m: float, y_m: float) -> str:
    """Name the direction of a place in sensor space (x forward, y left), in eighths."""
    return _SECTORS[round(math.atan2(y_m, x_m) / (math.pi / 4)) % 8]


def class_word(name: str) -> str:
    """Shorten a class name, which any recorded model may choose, to what fits a record."""
    printable = "".join(c if c.isascii() and c.isprintable() else "?" for c in name)
    return (
        printable if len(printable) <= MAX_CLASS_LENGTH else printable[: MAX_CLASS_LENGTH - 1] + "~"
    )
