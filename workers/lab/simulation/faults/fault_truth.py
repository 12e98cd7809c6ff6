"""Truth of the planted faults of a log: `planted.json` in its truth folder."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import NS_PER_S
from workers.lab.simulation.faults.disturbances import Disturbance
from workers.lab.simulation.faults.fault_placement import Redraw
from workers.lab.simulation.faults.faults import GHOST_RADIUS_M, PlantedFailure
from workers.lab.simulation.faults.plan import SCENE_S, DisturbanceKind, FailureKind

FILE: Final = "planted.json"

_STRICT = ConfigDict(frozen=True, extra="forbid")


class FailureRow(BaseModel):
    """One planted failure."""

    model_config = _STRICT

    kind: FailureKind
    track: int = Field(description="True track; -1 for a ghost, which is a place.")
    class_name: str = Field(description="True class of the object.")
    scene: int = Field(description="Number of the scene in the log, from 0.")
    start_s: float = Field(description="Seconds from the first frame of the log.")
    end_s: float = Field(description="First instant after it.")
    start_ns: int = Field(description="The same, nanoseconds since the Unix epoch.")
    end_ns: int
    common_mode: bool = Field(description="Chosen so that the other stream tends to fail too.")
    because: str = Field(description="Reason: slow, long, touching; else empty.")
    other_track: int = Field(description="Partner in a label swap; -1 none.")
    place_m: tuple[float, float, float] | None = Field(
        description="Position of a ghost as it begins, world space."
    )
    range_m: float = Field(description="Range beyond which movers are labelled static; 0 no limit.")
    radius_m: float = Field(default=GHOST_RADIUS_M, description="Radius of a ghost.")
    slides_m_per_s: tuple[float, float] = Field(
        default=(0.0, 0.0), description="Velocity of a ghost along what stands, world x and y."
    )
    part: float = Field(
        default=1.0,
        description="Share of the object's points that get the wrong label, from one end on.",
    )


class DisturbanceRow(BaseModel):
    """One disturbance that is not a failure."""

    model_config = _STRICT

    kind: DisturbanceKind
    scene: int = Field(description="Number of the scene in the log, from 0.")
    start_s: float = Field(description="Seconds from the first frame of the log.")
    end_s: float = Field(description="First instant after it.")
    start_ns: int = Field(description="The same, nanoseconds since the Unix epoch.")
    end_ns: int
    strength: float = Field(description="Slip: radians per frame; leak: metres; intensity: factor.")
    shift_m: float = Field(description="Slip: metres per frame; swapped sensor: metres upwards.")


class RedrawRow(BaseModel):
    """A planned failure without a candidate in its scene."""

    model_config = _STRICT

    scene: int = Field(description="Scene of the plan.")
    kind: FailureKind = Field(description="Planned kind.")
    became: FailureKind | None = Field(description="Kind planted instead; null: nothing.")
    in_scene: int = Field(description="Scene of the planted failure.")


class PlantedTruth(BaseModel):
    """All faults that were planted in a log."""

    model_config = _STRICT

    scene_s: float = Field(default=SCENE_S, description="Length of a scene, seconds.")
    hard: bool = Field(default=False, description="Dense traffic, vegetation, turns, bumps.")
    lifelike: bool = Field(default=False, description="Labels with the noise of a real model.")
    failures: tuple[FailureRow, ...] = ()
    disturbances: tuple[DisturbanceRow, ...] = ()
    redraws: tuple[RedrawRow, ...] = ()

    @classmethod
    def beside(cls, folder: Path) -> "PlantedTruth | None":
        """Read the planted faults from a truth folder; None without such a file."""
        file = folder / FILE
        return cls.model_validate_json(file.read_text()) if file.is_file() else None


@dataclass(frozen=True, slots=True)
class PlantedFaults:
    """Faults to plant in a log.

    Attributes:
        failures: Failures of the on-board model.
        disturbances: Disturbances that are no failure.
        redraws: Planned failures without a candidate in their scene.
        hard: Whether the log is a hard one.
        lifelike: Whether the labels have the noise of a real model.
    """

    failures: tuple[PlantedFailure, ...] = ()
    disturbances: tuple[Disturbance, ...] = ()
    redraws: tuple[Redraw, ...] = ()
    hard: bool = False
    lifelike: bool = False

    def truth(self, start_ns: int) -> PlantedTruth:
        """Build the truth file of a log whose first frame has this stamp."""
        return PlantedTruth(
            hard=self.hard,
            lifelike=self.lifelike,
            failures=tuple(_failure_row(each, start_ns) for each in self.failures),
            disturbances=_disturbance_rows(self.disturbances, start_ns),
            redraws=tuple(
                RedrawRow(
                    scene=each.planned.cell,
                    kind=each.planned.kind,
                    became=each.kind,
                    in_scene=each.cell,
                )
                for each in self.redraws
            ),
        )


NOTHING_PLANTED: Final = PlantedFaults()


def _failure_row(each: PlantedFailure, start_ns: int) -> FailureRow:
    return FailureRow(
        kind=each.kind,
        track=each.track,
        class_name=each.class_name,
        scene=int(each.start_s // SCENE_S) if each.cell < 0 else each.cell,
        start_s=each.start_s,
        end_s=each.end_s,
        start_ns=start_ns + round(each.start_s * NS_PER_S),
        end_ns=start_ns + round(each.end_s * NS_PER_S),
        common_mode=each.common_mode,
        because=each.because,
        other_track=each.other_track,
        place_m=each.place_m,
        range_m=each.range_m,
        radius_m=each.radius_m,
        slides_m_per_s=each.slides_m_per_s,
        part=each.part,
    )


def _disturbance_rows(
    disturbances: Sequence[Disturbance], start_ns: int
) -> tuple[DisturbanceRow, ...]:
    return tuple(
        DisturbanceRow(
            kind=each.kind,
            scene=each.cell,
            start_s=each.start_s,
            end_s=each.end_s,
            start_ns=start_ns + round(each.start_s * NS_PER_S),
            end_ns=start_ns + round(each.end_s * NS_PER_S),
            strength=each.strength,
            shift_m=each.shift_m,
        )
        for each in disturbances
    )
