"""What was planted in a log, as it lies beside its truth: `planted.json`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import NS_PER_S
from workers.lab.simulation.faults.disturbances import Disturbance
from workers.lab.simulation.faults.fault_placement import Redraw
from workers.lab.simulation.faults.faults import PlantedFailure
from workers.lab.simulation.faults.plan import SCENE_S, DisturbanceKind, FailureKind

FILE: Final = "planted.json"

_STRICT = ConfigDict(frozen=True, extra="forbid")


class FailureRow(BaseModel):
    """One planted failure."""

    model_config = _STRICT

    kind: FailureKind
    track: int = Field(description="Of the truth; -1 for a ghost, which is a place.")
    class_name: str = Field(description="What the thing really is.")
    scene: int = Field(description="Which scene of the log, from 0.")
    start_s: float = Field(description="Seconds from the first frame of the log.")
    end_s: float = Field(description="First instant after it.")
    start_ns: int = Field(description="The same, nanoseconds since the Unix epoch.")
    end_ns: int
    common_mode: bool = Field(description="Chosen so that the other stream tends to err as well.")
    because: str = Field(description="Why it may: slow, long, touching; empty else.")
    other_track: int = Field(description="Whose labels it has in a swap; -1 none.")
    place_m: tuple[float, float, float] | None = Field(description="Of a ghost, world space.")
    range_m: float = Field(description="Beyond it movers are called static; 0 no limit.")


class DisturbanceRow(BaseModel):
    """One disturbance that is not a failure."""

    model_config = _STRICT

    kind: DisturbanceKind
    scene: int = Field(description="Which scene of the log, from 0.")
    start_s: float = Field(description="Seconds from the first frame of the log.")
    end_s: float = Field(description="First instant after it.")
    start_ns: int = Field(description="The same, nanoseconds since the Unix epoch.")
    end_ns: int
    strength: float = Field(description="Of a slip radians a frame; of a leak metres; a factor.")
    shift_m: float = Field(description="Of a slip metres a frame; of a swapped sensor upwards.")


class RedrawRow(BaseModel):
    """A failure for which its scene held no thing."""

    model_config = _STRICT

    scene: int = Field(description="Where it was planned.")
    kind: FailureKind = Field(description="What was planned.")
    became: FailureKind | None = Field(description="What was planted instead; null: nothing.")
    in_scene: int = Field(description="Where.")


class PlantedTruth(BaseModel):
    """Everything that was put into a log on purpose."""

    model_config = _STRICT

    scene_s: float = Field(default=SCENE_S, description="Length of a scene, seconds.")
    hard: bool = Field(default=False, description="Dense traffic, vegetation, turns, bumps.")
    failures: tuple[FailureRow, ...] = ()
    disturbances: tuple[DisturbanceRow, ...] = ()
    redraws: tuple[RedrawRow, ...] = ()

    @classmethod
    def beside(cls, folder: Path) -> "PlantedTruth | None":
        """Read what was planted in the log of this truth; None where nothing says so."""
        file = folder / FILE
        return cls.model_validate_json(file.read_text()) if file.is_file() else None


@dataclass(frozen=True, slots=True)
class Planted:
    """What is put into a log on purpose.

    Attributes:
        failures: What the model on the car gets wrong.
        disturbances: What disturbs without being a failure.
        redraws: What was wanted and not found.
        hard: Whether the log is a hard one.
    """

    failures: tuple[PlantedFailure, ...] = ()
    disturbances: tuple[Disturbance, ...] = ()
    redraws: tuple[Redraw, ...] = ()
    hard: bool = False

    def truth(self, start_ns: int) -> PlantedTruth:
        """Make the file of a log whose first frame has this stamp."""
        return PlantedTruth(
            hard=self.hard,
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


NOTHING_PLANTED: Final = Planted()


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
