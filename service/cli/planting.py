"""Options and tables of `bench failures --plant`."""

from collections.abc import Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Final

from service.cli.output import counted, remark, table
from service.errors import UsageError

if TYPE_CHECKING:
    from workers.lab.evaluation.failures.attribution import AttributionAccuracy
    from workers.lab.evaluation.failures.bench import FailureBench
    from workers.lab.evaluation.failures.intervals import Interval
    from workers.lab.evaluation.failures.planted import PlantedTable
    from workers.lab.evaluation.failures.planting.variants import Planting
    from workers.lab.evaluation.failures.ranking import RankingRow


BY_OBJECT: Final = (
    "by points: a stream is wrong where most of the points are; by object: labels of the "
    "supervised stream that lie on no object for half a second, as at the border of a mover, are "
    "no error"
)
"""The two verdicts that an attribution is compared with."""


def planting_of(
    *, variants: int, seed: int, frames: str, share: str, answer: str = "points"
) -> "Planting":
    """Build the settings of planting from the options.

    Raises:
        UsageError: If the range, the share or the answer is not of its form.
    """
    from workers.lab.evaluation.failures.planting.drive import FrameRange
    from workers.lab.evaluation.failures.planting.variants import Answer, Planting

    first, colon, end = frames.partition(":")
    digits = all(not each or (each.isascii() and each.isdecimal()) for each in (first, end))
    if not colon or not digits or (end and int(end) <= int(first or 0)):
        raise UsageError(f"--frames must be A:B with A under B, as 0:28 or 28:, got {frames!r}")
    try:
        part = float(Fraction(share))
    except (ValueError, ZeroDivisionError):
        part = 0.0
    if not 0.0 < part < 1.0:
        raise UsageError(f"--share must be over 0 and under 1, as 1/6 or 0.05, got {share!r}")
    if answer not in tuple(Answer):
        raise UsageError(f"--answer must be points or boxes, got {answer!r}")
    chosen = FrameRange(int(first or 0), int(end) if end else None)
    return Planting(variants=variants, seed=seed, frames=chosen, share=part, answer=Answer(answer))


def say_variants(bench: "FailureBench", found: "PlantedTable") -> None:
    """Print the tables of a benchmark that planted failures in variants of real drives."""
    by = f"by variant, {bench.within}" if bench.within else "by drive"
    table(
        f"planted, answers in {bench.answer}: {counted(found.failures, 'failure')} in "
        f"{found.failing_scenes} of {counted(found.scenes, 'scene')}; 95 % intervals {by}",
        (
            *("ranked by", "AP", "95 %", "AP at 5 %", "95 %"),
            *("precision", "95 %", "recall 5 %", "10 %"),
        ),
        [_row("score", found)] + [_row(name, row) for name, row in _best_first(found.baselines)],
    )
    table(
        "by kind of failure, against scenes without failure",
        ("kind", "scenes", "AP", "recall", "tracks", "attributed", "median rank"),
        (
            (
                *(kind, row.scenes, row.ap, row.recall_at_base, row.tracks),
                *(row.attributed / row.tracks if row.tracks else None, row.median_rank_share),
            )
            for kind, row in found.kinds.items()
        ),
    )
    parts = {
        "all, by points": found.attribution,
        "all, by object": found.attribution_by_object,
        "on planted failures": found.attribution_of_failures,
        "elsewhere": found.attribution_of_others,
    }
    table(
        "attribution: balanced accuracy, and recall by true verdict",
        ("tracks", "accuracy", *(f"{verdict}" for verdict in found.attribution.cases)),
        ((name, part.accuracy, *_recalls(part)) for name, part in parts.items() if part),
    )
    remark(BY_OBJECT)
    remark(
        "AP: average precision; AP at 5 %: the same with scenes without failure weighted so that "
        "5 % fail; precision: among as many scenes as fail, where it equals recall; attributed: "
        "share of the contradicting tracks on its objects with the true verdict; median rank: 0 is "
        "first, 1 is last"
    )
    remark(
        f"gain over {found.best_baseline}: {found.gain} {found.gain_interval or ''}; the labels "
        f"show {found.planted - found.unseen} of {found.planted} planted failures, and the others "
        f"cannot be found; kind other: the noise alone is wrong on an object for half a second"
    )
    for log_id, reason in bench.skipped.items():
        remark(f"nothing planted in {log_id}: {reason}", level="warning")


def _recalls(part: "AttributionAccuracy") -> list[str]:
    return [
        "" if recall is None else f"{recall:.3f} of {part.cases[verdict]}"
        for verdict, recall in part.recall.items()
    ]


def _row(name: str, row: "RankingRow") -> tuple[object, ...]:
    return (
        *(name, row.ap, _interval(row.ap_interval)),
        *(row.rare_ap, _interval(row.rare_ap_interval)),
        *(row.precision_at_base, _interval(row.precision_at_base_interval)),
        *(row.recall_at["5"], row.recall_at["10"]),
    )


def _interval(interval: "Interval | None") -> str:
    return "" if interval is None else f"{interval[0]:.3f} to {interval[1]:.3f}"


def _best_first(rows: "Mapping[str, RankingRow]") -> "list[tuple[str, RankingRow]]":
    return sorted(rows.items(), key=lambda each: -(each[1].ap or 0.0))
