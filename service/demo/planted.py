"""Scenes of the demo's fleet, each with its planted failures and disturbances."""

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
    """A ranked scene and its truth.

    Attributes:
        row: Its row of the ranking.
        record: Its published record.
        at_s: Seconds from the first scene of its log.
        failures: Kinds of failures planted into the labels of the model on the car, in words.
        disturbances: Kinds of disturbances that are no failures, in words.
        is_about_track: True if its first reason is about a track, false if it explains a low score.
        named: True if its first reason is about a planted failure; None without one.
    """

    row: RankedScene
    record: SceneScore
    at_s: int
    failures: tuple[str, ...]
    disturbances: tuple[str, ...]
    is_about_track: bool
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
    def wrong(self) -> str:
        """Stream that is probably wrong about the first reason's track, with its probability."""
        said = self.record.tracks[0].attribution if self.is_about_track else None
        return f"{_WORDS[said.wrong]} {said.chance:.0%}" if said else "-"

    @property
    def why(self) -> str:
        """Headline of its first reason, without the attribution, which has a column of its own."""
        if not self.record.reasons:
            return "-"
        headline = self.record.reasons[0].headline
        return headline.rpartition(": ")[0] if self.is_about_track else headline


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
        is_about_track = record.score > 0 and worth
        if known and failures and is_about_track:
            points = PlantedPoints(truth / row.log_id)
            named = points.first_reason_names(overlay_of(row.scene_id), known.failures)
        scenes.append(
            DemoScene(
                row=row,
                record=record,
                at_s=round((row.start_ns - begins_ns[row.log_id]) / NS_PER_S),
                failures=failures,
                disturbances=_within(known.disturbances, row) if known else (),
                is_about_track=is_about_track,
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
