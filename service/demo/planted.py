"""Scenes of the demo's fleet, each with its planted failures and disturbances."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from schemas.arrays import NS_PER_S
from schemas.overlay import Overlay
from schemas.score import MIN_REPORTED_STRENGTH, SceneScore
from service.curation.ranking import RankedScene
from service.demo.scored_explanations import PlantedPoints

if TYPE_CHECKING:
    from workers.lab.simulation.faults.fault_truth import DisturbanceRow, FailureRow


@dataclass(frozen=True, slots=True)
class DemoScene:
    """A ranked scene and its truth.

    Attributes:
        row: Its row of the ranking.
        record: Its published record.
        at_s: Seconds from the first scene of its log.
        failures: Kinds of failures planted into the labels of the model on the car, in words.
        disturbances: Kinds of disturbances that are no failures, in words.
        named: True if its first reason is about a planted failure; None without one.
    """

    row: RankedScene
    record: SceneScore
    at_s: int
    failures: tuple[str, ...]
    disturbances: tuple[str, ...]
    named: bool | None = None

    @property
    def street(self) -> str:
        """Last part of its log's name, unique in the demo."""
        return self.row.log_id.rpartition("/")[2]

    @property
    def name(self) -> str:
        """Street and second, short enough for a table."""
        return f"{self.street} at {self.at_s} s"

    @property
    def file_name(self) -> str:
        """File name of its picture, with the rank first, so that a folder lists them in order."""
        return f"{self.row.rank:02}-{self.street}-{self.at_s}s.png"

    @property
    def planted(self) -> str:
        """Planted failures, then disturbances; a dash for none."""
        words = [", ".join(self.failures)] if self.failures else []
        if self.disturbances:
            words.append(f"disturbed: {', '.join(self.disturbances)}")
        return "; ".join(words) or "-"

    @property
    def headline(self) -> str:
        """Headline of the scene, which is its first reason's; a dash without a reason."""
        return self.record.reasons[0].headline if self.record.reasons else "-"


def with_truth(
    ranking: Sequence[RankedScene],
    records: Mapping[str, SceneScore],
    truth: Path,
    *,
    overlay_of: Callable[[str], Overlay],
) -> list[DemoScene]:
    """Join the scenes of a simulated fleet with the failures planted into them.

    Args:
        ranking: All of its scenes, best first.
        records: Their records, by scene id.
        truth: Folder of its truth.
        overlay_of: Reads the overlay of a scene; called for those with a failure and a reason.
    """
    from workers.lab.simulation.faults.fault_truth import PlantedTruth

    begins_ns = {
        log_id: min(row.start_ns for row in ranking if row.log_id == log_id)
        for log_id in {row.log_id for row in ranking}
    }
    planted = {log_id: PlantedTruth.beside(truth / log_id) for log_id in begins_ns}
    scenes = []
    for row in ranking:
        known, record = planted[row.log_id], records[row.scene_id]
        failures = _within(known.failures, row) if known else ()
        named = False if failures else None
        worth = bool(record.tracks) and record.tracks[0].strength >= MIN_REPORTED_STRENGTH
        if known and failures and record.score > 0 and worth:
            points = PlantedPoints(truth / row.log_id)
            named = points.first_reason_names(overlay_of(row.scene_id), known.failures)
        scenes.append(
            DemoScene(
                row=row,
                record=record,
                at_s=round((row.start_ns - begins_ns[row.log_id]) / NS_PER_S),
                failures=failures,
                disturbances=_within(known.disturbances, row) if known else (),
                named=named,
            )
        )
    return scenes


def _within(planted: "Sequence[FailureRow | DisturbanceRow]", row: RankedScene) -> tuple[str, ...]:
    """Return each kind present in a frame of the scene, once."""
    there = [
        each.kind.value.replace("_", " ")
        for each in planted
        if each.start_ns <= row.end_ns and row.start_ns < each.end_ns
    ]
    return tuple(dict.fromkeys(there))
