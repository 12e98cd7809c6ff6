"""The file `planted.json` of a benchmark that plants failures: what it planted, and where."""

from collections.abc import Sequence
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import NS_PER_S
from workers.lab.evaluation.failures.planting.variants import Answer, Planting
from workers.lab.evaluation.failures.rows import MinedLog
from workers.lab.simulation.faults.fault_truth import FailureRow

_STRICT = ConfigDict(frozen=True, extra="forbid")


class PlantedInVariant(FailureRow):
    """One planted failure; times and track are those of the drive."""

    shown: bool = Field(
        description="Whether the labels show it: 25 points and most of the object, for half a "
        "second. One that they do not show cannot be found, and counts as none."
    )
    wrong: Literal["supervised", "both"] | None = Field(
        description="Streams that are wrong on it; null where the labels do not show it."
    )


class VariantRow(BaseModel):
    """One variant of a drive."""

    model_config = _STRICT

    log_id: str = Field(description="The log.")
    number: int = Field(description="Number of the variant, from 0.")
    scores: tuple[float, ...] = Field(description="Score of each of its scenes.")
    failures: tuple[PlantedInVariant, ...] = ()


class PlantedFile(BaseModel):
    """All variants of a benchmark."""

    model_config = _STRICT

    generator: Literal["counterpoint"] = Field(
        default="counterpoint", description="Writer of the file, by which it knows its own."
    )
    bucket: str
    frames: str = Field(description="Range of frames of each log, as `--frames` takes it.")
    seed: int
    share: float = Field(description="Share of the scenes that get a failure.")
    answer: Answer = Field(
        default=Answer.POINTS, description="Form of the model's answers: points or boxes."
    )
    variants: tuple[VariantRow, ...]


def planted_file(bucket: str, planting: Planting, logs: Sequence[MinedLog]) -> PlantedFile:
    """List the planted failures of all variants."""
    return PlantedFile(
        bucket=bucket,
        frames=str(planting.frames),
        seed=planting.seed,
        share=planting.share,
        answer=planting.answer,
        variants=tuple(_variant(log) for log in logs),
    )


def _variant(log: MinedLog) -> VariantRow:
    log_id, _, number = log.log_id.rpartition("#")
    return VariantRow(
        log_id=log_id,
        number=int(number),
        scores=tuple(scene.score for scene in log.scenes),
        failures=tuple(
            PlantedInVariant(
                **failure.model_dump(), shown=place in log.shown, wrong=_wrong(log, place)
            )
            for place, failure in enumerate(log.failures)
        ),
    )


def _wrong(log: MinedLog, place: int) -> Literal["supervised", "both"] | None:
    """Return the streams that are wrong on the objects that show a failure."""
    failure = log.failures[place]
    if place not in log.shown:
        return None
    shares = [
        thing.other_wrong_share
        for scene in log.scenes
        if scene.start_ns < failure.end_ns
        and failure.start_ns < scene.start_ns + scene.seconds * NS_PER_S
        for thing in scene.failing
        if thing.kind == failure.kind.value
    ]
    return "both" if shares and min(shares) > 0.5 else "supervised"
