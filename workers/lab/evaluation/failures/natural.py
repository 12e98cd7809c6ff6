"""The table *natural*: failures of a supervised network per object of interest."""

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from workers.lab.evaluation.failures.attribution import AttributionAccuracy, evaluate_attribution
from workers.lab.evaluation.failures.calibration import Calibration, calibrate
from workers.lab.evaluation.failures.ranking import (
    MINUTE_S,
    RANDOM,
    Items,
    RankingRow,
    best_of,
    random_row,
    row_of,
)
from workers.lab.evaluation.failures.rows import MinedLog, ObjectRow, SceneRow


class ClassRow(BaseModel):
    """Failures on objects of one class."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    things: int
    failing: int
    found: int = Field(description="Failing ones with a contradicting track.")


class NaturalTable(RankingRow):
    """Ranking of the objects of a fleet by contradiction, compared with the baseline scores."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    things: int = Field(description="True objects, phantoms and other contradicting clusters.")
    failing_things: int = Field(description="Objects per scene on which the stream fails.")
    failing_scenes: int
    baselines: dict[str, RankingRow] = Field(
        description="Baseline rankings by name, each over the objects that it scores."
    )
    best_baseline: str
    attribution_accuracy: float | None
    attribution: AttributionAccuracy
    calibration: Calibration = Field(description="Of an object's strength against its failing.")
    classes: dict[str, ClassRow] = Field(description="By true class and motion.")


def natural_table(logs: Sequence[MinedLog], *, draws: int) -> NaturalTable:
    """Compute the table from logs that were mined with a network; it ranks objects, not scenes.

    The score of an object is the strength of its strongest contradicting track, 0 without any.
    """
    listed = [
        (number, scene, thing)
        for number, log in enumerate(logs)
        for scene in log.scenes
        for thing in scene.things
    ]
    strengths = np.array([strength_of(scene, thing) for _, scene, thing in listed])
    items = Items(
        logs=np.array([number for number, _, _ in listed], dtype=np.int64),
        wanted=np.array([thing.fails for _, _, thing in listed], dtype=np.bool_),
        failures=[
            [f"{logs[n].log_id} {_name(scene, thing)}"] if thing.fails else []
            for n, scene, thing in listed
        ],
        minutes=np.array([scene.seconds / MINUTE_S for _, scene, _ in listed]),
        scenes=sum(len(log.scenes) for log in logs),
    )
    baselines = {RANDOM: random_row(items)}
    for name in sorted({name for _, _, thing in listed for name in thing.views}):
        scored = np.array([name in thing.views for _, _, thing in listed], dtype=np.bool_)
        view = np.array([thing.views[name] for _, _, thing in listed if name in thing.views])
        baselines[name] = row_of(view, _only(items, scored), draws=draws)
    scenes = [scene for log in logs for scene in log.scenes]
    attribution = evaluate_attribution(track for scene in scenes for track in scene.tracks)
    return NaturalTable(
        **row_of(strengths, items, draws=draws).model_dump(),
        things=len(listed),
        failing_things=int(items.wanted.sum()),
        failing_scenes=sum(scene.fails for scene in scenes),
        baselines=baselines,
        best_baseline=best_of(baselines),
        attribution_accuracy=attribution.accuracy,
        attribution=attribution,
        calibration=calibrate(strengths, items.wanted),
        classes=_classes([(scene, thing) for _, scene, thing in listed]),
    )


def strength_of(scene: SceneRow, thing: ObjectRow) -> float:
    """Return the strength of an object's strongest track, which already weighs attribution."""
    return max((each.strength for each in scene.tracks if each.thing == thing.key), default=0.0)


def _name(scene: SceneRow, thing: ObjectRow) -> str:
    return thing.key if thing.track >= 0 else f"{scene.scene_id} {thing.key}"


def _only(items: Items, scored: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Items:
    return Items(
        items.logs[scored],
        items.wanted[scored],
        [names for names, kept in zip(items.failures, scored.tolist(), strict=True) if kept],
        items.minutes[scored],
        items.scenes,
    )


def _classes(listed: Sequence[tuple[SceneRow, ObjectRow]]) -> dict[str, ClassRow]:
    groups: dict[str, list[tuple[SceneRow, ObjectRow]]] = {}
    for scene, thing in listed:
        what = thing.class_name or ("nobody's" if thing.track < 0 else "unknown")
        state = "moving" if thing.moves else "standing"
        groups.setdefault(f"{what}, {state}", []).append((scene, thing))
    return {
        name: ClassRow(
            things=len(group),
            failing=sum(thing.fails for _, thing in group),
            found=sum(thing.fails and strength_of(scene, thing) > 0.0 for scene, thing in group),
        )
        for name, group in sorted(groups.items())
    }
