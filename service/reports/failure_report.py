"""Report of the failure benchmark: tables and plots in one self-contained page."""

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Final

from schemas.visible import visible
from service.output_files import PAGE_MARK, save_text
from service.reports.failure_plots import html_table, plot

if TYPE_CHECKING:
    from workers.lab.evaluation.failures.attribution import AttributionAccuracy
    from workers.lab.evaluation.failures.bench import FailureBench
    from workers.lab.evaluation.failures.calibration import Calibration
    from workers.lab.evaluation.failures.intervals import Interval
    from workers.lab.evaluation.failures.natural import NaturalTable
    from workers.lab.evaluation.failures.planted import PlantedTable
    from workers.lab.evaluation.failures.ranking import RankingRow

_STYLE: Final = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2em auto; max-width: 1080px; color: #212529 }
table { border-collapse: collapse; margin: 1em 0 } th { text-align: left; border-bottom: 2px solid }
td, th { padding: .2em .8em .2em 0 } td { border-bottom: 1px solid #dee2e6 }
svg { margin: .5em 1em .5em 0 } .title { font-weight: 600; font-size: 14px }
.tick { font-size: 11px; fill: #495057 } .end { text-anchor: end } .mid { text-anchor: middle }
.grid { stroke: #e9ecef } .diagonal { stroke: #868e96; stroke-dasharray: 4 4 }
"""

COLUMNS_MEAN: Final = (
    "AP: average precision; 95 %: bootstrap interval over logs; AP at 5 %: the same with scenes "
    "without failure weighted so that 5 % fail; precision at base: among as many items as fail; "
    "precision, recall and lift "
    "(precision over that of a random order) at a budget in percent of the ranked items; found per "
    "minute: distinct failures per minute of reviewed recording; found area: area under the share "
    "of failures found, 0.5 for a random order; median rank: 0 is first, 1 is last"
)
"""Meaning of the columns of a ranking, on the page and in the terminal."""

_DOES: Final = "effect on the labels of the on-board model"
_BUDGETS: Final = ("0.5", "1", "2", "5", "10")


def write_report(file: Path, bench: "FailureBench", *, force: bool = False) -> None:
    """Write the page of a benchmark, whole or not at all.

    Raises:
        UsageError: If it cannot be written, or another file lies there and `force` is not given.
    """
    parts = [
        "<h1>Failures found by contradiction</h1>",
        _paragraph(f"{bench.bucket}, {bench.logs} logs"),
        *(
            f"<p>Evaluated in <i>{_safe(table)}</i>: the supervised stream {_safe(stream)}.</p>"
            for table, stream in bench.judged.items()
        ),
    ]
    if bench.planted is not None:
        if bench.variants:
            parts.append(_paragraph(_variants(bench)))
        parts += _planted(bench.planted)
    if bench.natural is not None:
        parts += _natural(bench.natural)
    page = (
        f'<!doctype html><html lang="en"><meta charset="utf-8">{PAGE_MARK}<title>Failures</title>'
        f"<style>{_STYLE}</style>{''.join(parts)}</html>\n"
    )
    save_text(page, file, option="--report", force=force)


def _safe(value: object) -> str:
    """Escape a value that may contain anything, such as the name of a bucket, for a page."""
    return escape(visible(str(value)))


def _paragraph(text: str) -> str:
    return f"<p>{_safe(text)}</p>"


def _variants(bench: "FailureBench") -> str:
    drawn = f"variants, {bench.within}" if bench.within else "drives"
    skipped = f"; nothing planted in {', '.join(bench.skipped)}" if bench.skipped else ""
    return f"{bench.variants} variants of each drive; intervals draw {drawn}{skipped}."


def _planted(found: "PlantedTable") -> list[str]:
    from workers.lab.simulation.faults.plan import DISTURBANCE_MEANS, FAILURE_MEANS

    shares = dict(found.disturbances) | ({"slips": found.slips} if found.slips else {})
    shared = found.common_mode
    failures = {kind.value: means for kind, means in FAILURE_MEANS.items()}
    disturbances = {kind.value: means for kind, means in DISTURBANCE_MEANS.items()}
    return [
        "<h2>Planted</h2>",
        _paragraph(
            f"{found.failures} failures in {found.failing_scenes} of {found.scenes} scenes; "
            f"the labels show {found.planted - found.unseen} of {found.planted} planted ones."
        ),
        _paragraph(f"{COLUMNS_MEAN}."),
        _ranking({"score": found, **found.baselines}),
        _paragraph(
            f"Gain over the best baseline, {found.best_baseline}: {found.gain} "
            f"{found.gain_interval or ''}."
        ),
        _curves({"score": found, **found.baselines}, "scenes"),
        _reliability("score: share of scenes with a failure", found.calibration),
        "<h3>By kind, against scenes without failure</h3>",
        html_table(
            (
                *("kind", "scenes", "AP", *(f"recall {b} %" for b in _BUDGETS)),
                *("recall at base", "tracks", "attributed correctly", "median rank", _DOES),
            ),
            [
                (
                    *(kind, row.scenes, row.ap, *row.recall_at.values(), row.recall_at_base),
                    *(row.tracks, row.attributed, row.median_rank_share),
                    failures.get(kind, "wrong labels where nothing was planted"),
                )
                for kind, row in found.kinds.items()
            ],
        ),
        "<h3>False alarms: scenes without failure above the 5 % budget of undisturbed scenes</h3>",
        html_table(
            ("disturbed by", "scenes", "above", "share", "effect on the recording"),
            [
                (name, row.scenes, row.above, row.share, disturbances.get(name))
                for name, row in shares.items()
            ],
        ),
        _paragraph(
            f"Common mode, failures that both streams should miss: both are wrong on "
            f"{shared.both_wrong} of {shared.planted}. The witness contradicts both on "
            f"{shared.witnessed}; {shared.in_budget} are in the first 10 %, {shared.surfaced} "
            "fulfil both conditions."
        ),
        *_who(found.attribution),
        _paragraph(
            f"By object, where labels that lie on no object are no error: balanced accuracy "
            f"{found.attribution_by_object.accuracy}."
        ),
    ]


def _natural(found: "NaturalTable") -> list[str]:
    return [
        "<h2>Natural</h2>",
        _paragraph(
            f"The stream fails on {found.failing_things} of {found.things} objects, "
            f"in {found.failing_scenes} of {found.scenes} scenes."
        ),
        _paragraph(f"{COLUMNS_MEAN}."),
        _ranking({"strength": found, **found.baselines}),
        _curves({"strength": found, **found.baselines}, "objects"),
        _reliability("strength: share of objects that fail", found.calibration),
        html_table(
            ("objects", "count", "failing", "failing and contradicting"),
            [(name, r.things, r.failing, r.found) for name, r in found.classes.items()],
        ),
        *_who(found.attribution),
    ]


def _ranking(rows: "Mapping[str, RankingRow]") -> str:
    columns: tuple[str, ...] = ("ranked by", "of", "AP", "95 %", "AP at 5 %", "95 %")
    columns += ("precision at base", "95 %", *(f"precision {b} %" for b in _BUDGETS))
    columns += (*(f"recall {b} %" for b in _BUDGETS), "lift 5 %", "found per minute", "found area")
    return html_table(
        columns,
        [
            (
                *(name, row.ranked, row.ap, _interval(row.ap_interval)),
                *(row.rare_ap, _interval(row.rare_ap_interval)),
                *(row.precision_at_base, _interval(row.precision_at_base_interval)),
                *(row.precision_at[budget] for budget in _BUDGETS),
                *(row.recall_at[budget] for budget in _BUDGETS),
                *(row.lift_at["5"], row.found_per_minute_at["5"], row.found_area),
            )
            for name, row in rows.items()
        ],
    )


def _interval(interval: "Interval | None") -> str:
    return "" if interval is None else "{:.2f} to {:.2f}".format(*interval)


def _curves(rows: "Mapping[str, RankingRow]", what: str) -> str:
    lines = {
        name: [(place / (len(row.curve) - 1), y) for place, y in enumerate(row.curve)]
        for name, row in rows.items()
    }
    return plot("failures found", lines, x=f"share of {what} reviewed", y="share of failures")


def _reliability(title: str, found: "Calibration") -> str:
    error = "" if found.ece is None else f", expected calibration error {found.ece:.3f}"
    line = {title: [(each.said, each.was) for each in found.bins]}
    return plot(f"{title}{error}", line, x="predicted", y="observed", dots=True, diagonal=True)


def _who(found: "AttributionAccuracy") -> list[str]:
    return [
        "<h3>Attribution</h3>",
        _paragraph(f"Balanced accuracy {found.accuracy}; of a constant answer {found.commonest}."),
        html_table(
            ("true", "tracks", "recall", *(f"attributed: {name}" for name in found.cases)),
            [
                (name, count, found.recall[name], *found.confusion[name].values())
                for name, count in found.cases.items()
            ],
        ),
        _reliability("attribution: share of correct ones", found.calibration),
    ]
