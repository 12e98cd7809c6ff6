"""The scenes of the demo's fleet, each beside what was put into it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from schemas.arrays import NS_PER_S
from schemas.attribution import Wrong
from schemas.overlay import Overlay
from schemas.score import SceneScore
from service.curation.ranking import RankedScene
from service.demo.scored_explanations import PlantedPoints

if TYPE_CHECKING:
    from workers.lab.simulation.faults.fault_truth import DisturbanceRow, FailureRow


_WORDS: Final = {
    Wrong.SUPERVISED: "supervised",
    Wrong.SELFSUPERVISED: "self-supervised",
    Wrong.BOTH: "both",
    Wrong.NEITHER: "neither",
}


@dataclass(frozen=True, slots=True)
class DemoScene:
    """A ranked scene and what truth knows of it.

    Attributes:
        row: Of the ranking.
        record: What was published.
        at_s: Seconds from the first scene of its log.
        failures: Kinds of what the model on the car was made to get wrong in it, in words.
        disturbances: Kinds of what disturbs in it without being a failure, in words.
        told: Whether its first reason tells of a track, and not of what held it down.
        named: Whether its first reason tells of a failure that was planted; None where none was.
    """

    row: RankedScene
    record: SceneScore
    at_s: int
    failures: tuple[str, ...]
    disturbances: tuple[str, ...]
    told: bool
    named: bool | None = None

    @property
    def street(self) -> str:
        """Last part of its log's name: no two logs of the demo share it."""
        return self.row.log_id.rpartition("/")[2]

    @property
    def name(self) -> str:
        """Street and second: short enough for a table."""
        return f"{self.street} at {self.at_s} s"

    @property
    def file_name(self) -> str:
        """Of its picture: the rank first, so that a folder lists them in order."""
        return f"{self.row.rank:02}-{self.street}-{self.at_s}s.png"

    @property
    def planted(self) -> str:
        """What was put into it: failures, then disturbances; a dash for nothing."""
        told = [", ".join(self.failures)] if self.failures else []
        if self.disturbances:
            told.append(f"disturbed: {', '.join(self.disturbances)}")
        return "; ".join(told) or "-"

    @property
    def wrong(self) -> str:
        """Who probably errs about the track that is told, and how probably; else a dash."""
        said = self.record.tracks[0].attribution if self.told else None
        return f"{_WORDS[said.wrong]} {said.chance:.0%}" if said else "-"

    @property
    def why(self) -> str:
        """Headline of its first reason, without the verdict, which has a column of its own."""
        if not self.record.reasons:
            return "-"
        headline = self.record.reasons[0].headline
        return headline.rpartition(": ")[0] if self.told else headline


def beside_truth(
    ranking: Sequence[RankedScene],
    records: Mapping[str, SceneScore],
    truth: Path,
    *,
    overlay_of: Callable[[str], Overlay],
) -> list[DemoScene]:
    """Hold each scene of a simulated fleet beside what was planted in it.

    Args:
        ranking: All of its scenes, best first.
        records: Theirs, by scene.
        truth: Folder of its truth.
        overlay_of: Reads the points of a scene; asked for those with a failure and a reason.
    """
    from workers.contradiction.reasons import MIN_REPORTED_STRENGTH
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
        told = record.score > 0 and worth
        if known and failures and told:
            points = PlantedPoints(truth / row.log_id)
            named = points.first_reason_names(overlay_of(row.scene_id), known.failures)
        scenes.append(
            DemoScene(
                row=row,
                record=record,
                at_s=round((row.start_ns - begins_ns[row.log_id]) / NS_PER_S),
                failures=failures,
                disturbances=_within(known.disturbances, row) if known else (),
                told=told,
                named=named,
            )
        )
    return scenes


def _within(planted: "Sequence[FailureRow | DisturbanceRow]", row: RankedScene) -> tuple[str, ...]:
    """Name each kind once that is there in a frame of the scene."""
    there = [
        each.kind.value.replace("_", " ")
        for each in planted
        if each.start_ns <= row.end_ns and row.start_ns < each.end_ns
    ]
    return tuple(dict.fromkeys(there))
