"""The table *planted*: ranking of scenes by score, against failures planted in a fleet."""

from collections import Counter
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from workers.lab.evaluation.failures.attribution import (
    AttributionAccuracy,
    by_object,
    evaluate_attribution,
)
from workers.lab.evaluation.failures.calibration import Calibration, calibrate
from workers.lab.evaluation.failures.common_mode import CommonMode, common_mode
from workers.lab.evaluation.failures.false_alarms import (
    FalseAlarmShare,
    by_disturbance,
    slip_false_alarms,
)
from workers.lab.evaluation.failures.intervals import Interval, bootstrap
from workers.lab.evaluation.failures.kinds import KindRow, figures_by_kind
from workers.lab.evaluation.failures.ranking import (
    MINUTE_S,
    RANDOM,
    Items,
    RankingRow,
    best_of,
    random_row,
    row_of,
)
from workers.lab.evaluation.failures.retrieval import retrieve
from workers.lab.evaluation.failures.rows import OTHER_KIND, MinedLog, SceneRow, TrackRow


class PlantedTable(RankingRow):
    """Ranking of the scenes of a fleet by score, compared with the baseline scores.

    The figures at the top are those of the score.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    failing_scenes: int
    planted: int = Field(description="Failures that were planted.")
    unseen: int = Field(description="Of them, those that the labels do not show.")
    baselines: dict[str, RankingRow] = Field(description="Baseline rankings, by name.")
    best_baseline: str = Field(description="The baseline of highest average precision.")
    gain: float | None = Field(
        description="(AP - b) / (1 - b) against the best baseline's average precision b."
    )
    gain_interval: Interval | None = Field(description="95 %, against that baseline.")
    attribution_accuracy: float | None = Field(
        description="Mean recall over {supervised, selfsupervised, both, neither} that "
        "occur ten times; null: records without attribution."
    )
    attribution: AttributionAccuracy = Field(description="Over all tracks, by their points.")
    attribution_by_object: AttributionAccuracy = Field(
        description="The same, where labels that lie on no object are no error."
    )
    attribution_of_failures: AttributionAccuracy | None = Field(
        default=None, description="Of the tracks on planted failures alone."
    )
    attribution_of_others: AttributionAccuracy | None = Field(
        default=None, description="Of all other tracks."
    )
    common_mode_recall: float | None = Field(
        description="Share of planted failures on which both streams are wrong that surface."
    )
    common_mode: CommonMode
    calibration: Calibration = Field(description="Of the score against the scene's failing.")
    kinds: dict[str, KindRow] = Field(description="By kind of failure.")
    disturbances: dict[str, FalseAlarmShare] = Field(
        description="Scenes without failure above the score that marks the 5 % budget of the "
        "undisturbed scenes, by kind of disturbance."
    )
    slips: FalseAlarmShare | None = Field(
        description="The same for scenes that were mined again with a slip in each; null: not run."
    )


def planted_table(
    logs: Sequence[MinedLog],
    *,
    slipping: Sequence[MinedLog] = (),
    groups: Sequence[int] | None = None,
    draws: int,
) -> PlantedTable:
    """Compute the table.

    Args:
        logs: Logs of the fleet, mined with their recorded labels.
        slipping: Some of them, mined again with a slip in every scene.
        groups: Number of the drive of each log, for intervals; each log is its own when None.
        draws: Bootstrap draws; 0 computes no intervals.
    """
    scenes = [scene for log in logs for scene in log.scenes]
    items = items_of(logs, groups)
    scores = np.array([scene.score for scene in scenes])
    views = sorted({name for scene in scenes for name in scene.views})
    others = {name: np.array([scene.views[name] for scene in scenes]) for name in views}
    baselines = {RANDOM: random_row(items)}
    baselines |= {name: row_of(view, items, draws=draws) for name, view in others.items()}
    mine = row_of(scores, items, draws=draws)
    best = best_of(baselines)
    tracks = [track for scene in scenes for track in scene.tracks]
    attribution = evaluate_attribution(tracks)
    on_failures, elsewhere = _tracks_by_failure(scenes)
    shared = common_mode(scenes)
    return PlantedTable(
        **mine.model_dump(),
        failing_scenes=int(items.wanted.sum()),
        planted=sum(log.planted for log in logs),
        unseen=sum(log.unseen for log in logs),
        baselines=baselines,
        best_baseline=best,
        gain=_gain(mine.ap, baselines[best].ap),
        gain_interval=_gain_interval(scores, others.get(best), items, draws),
        attribution_accuracy=attribution.accuracy,
        attribution=attribution,
        attribution_by_object=evaluate_attribution(map(by_object, tracks)),
        attribution_of_failures=evaluate_attribution(on_failures),
        attribution_of_others=evaluate_attribution(elsewhere),
        common_mode_recall=shared.recall,
        common_mode=shared,
        calibration=calibrate(scores, items.wanted),
        kinds=figures_by_kind(scenes, scores),
        disturbances=by_disturbance(scenes),
        slips=slip_false_alarms(scenes, [scene for log in slipping for scene in log.scenes]),
    )


def items_of(logs: Sequence[MinedLog], groups: Sequence[int] | None = None) -> Items:
    """Make scenes the ranked items; a failure that lasts over several scenes counts once."""
    drives = np.arange(len(logs)) if groups is None else np.asarray(groups, dtype=np.int64)
    scenes = [scene for log in logs for scene in log.scenes]
    return Items(
        logs=np.repeat(drives, [len(log.scenes) for log in logs]),
        wanted=np.array([scene.fails for scene in scenes], dtype=np.bool_),
        failures=[failure_names(scene, log.log_id) for log in logs for scene in log.scenes],
        minutes=np.array([scene.seconds / MINUTE_S for scene in scenes]),
        scenes=len(scenes),
    )


def failure_names(scene: SceneRow, log_id: str) -> list[str]:
    """Name the failures of a scene: one object of a log failing in one way is one failure.

    A label swap fails on two objects and a range limit on all beyond it: each is one failure per
    kind.
    """
    names = Counter(
        f"{log_id} {each.kind} {'' if each.kind in _OF_MANY else each.track} "
        f"{scene.cell if each.track < 0 or each.kind in _OF_MANY else ''}"
        for each in scene.failing
    )
    return sorted(names)


def _tracks_by_failure(scenes: Sequence[SceneRow]) -> tuple[list[TrackRow], list[TrackRow]]:
    """Return the tracks on planted failures, and all others."""
    on_failures: list[TrackRow] = []
    others: list[TrackRow] = []
    for scene in scenes:
        planted = {thing.key for thing in scene.failing if thing.kind != OTHER_KIND}
        for track in scene.tracks:
            (on_failures if track.thing in planted else others).append(track)
    return on_failures, others


_OF_MANY: Final = ("label_swap", "range_limit")


def _gain(ap: float | None, other: float | None) -> float | None:
    if ap is None or other is None or other >= 1.0:
        return None
    return round((ap - other) / (1.0 - other), 4)


def _gain_interval(
    scores: NDArray[np.float64], other: NDArray[np.float64] | None, items: Items, draws: int
) -> Interval | None:
    if other is None or not draws:
        return None

    def gain(drawn: NDArray[np.int64]) -> tuple[float | None]:
        wanted = items.wanted[drawn]
        mine, theirs = (retrieve(each[drawn], wanted, ()).ap for each in (scores, other))
        return (_gain(mine, theirs),)

    return bootstrap(items.logs.tolist(), gain, draws=draws)[0]
