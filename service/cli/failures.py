"""Verb `bench failures`: how well contradictions find failures, compared with other rankings."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import unquote, urlsplit

import typer

from service.cli.option_groups import MiningOptions, grouped
from service.cli.options import (
    MOST,
    Config,
    Force,
    Json,
    settings_for,
)
from service.cli.output import counted, json_line, progress, remark, table
from service.cli.planting import BY_OBJECT, planting_of, say_variants
from service.errors import UsageError
from service.output_files import need_folder, need_writable, save_text
from service.reports.failure_report import COLUMNS_MEAN, write_report

if TYPE_CHECKING:
    from workers.lab.evaluation.failures.attribution import AttributionAccuracy
    from workers.lab.evaluation.failures.bench import FailureBench
    from workers.lab.evaluation.failures.natural import NaturalTable
    from workers.lab.evaluation.failures.planted import PlantedTable
    from workers.lab.evaluation.failures.ranking import RankingRow

TABLES = ("planted", "natural")


@grouped
def failures(
    *,
    url: Annotated[
        str, typer.Argument(help="A fleet of `simulate`, or with --truth any bucket of logs.")
    ],
    truth: Annotated[
        Path | None,
        typer.Option(
            "--truth",
            help="Folder DIR with the truth of URL/x/y.mcap in DIR/x/y; see deploy/TRUTH.md.",
        ),
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(
            "--table",
            help="Failures to evaluate: planted or natural; default: both where the logs allow it.",
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="Write a page with plots to this file.")
    ] = None,
    workers: Annotated[
        int, typer.Option("--workers", min=1, max=MOST, help="Worker processes.")
    ] = 2,
    kept: Annotated[
        Path | None,
        typer.Option(
            "--kept", help="Folder of cached results; default: bench in the state folder."
        ),
    ] = None,
    slip_logs: Annotated[
        int,
        typer.Option(
            "--slip-logs",
            min=0,
            max=MOST,
            help="Logs mined again with an odometry slip in every scene (planted).",
        ),
    ] = 0,
    second: Annotated[
        Path | None,
        typer.Option(
            "--second", help="Folder of other weights, to measure the difference of two networks."
        ),
    ] = None,
    probe_every: Annotated[
        int,
        typer.Option(
            "--dropout-every", min=0, max=MOST, help="Interval of frames with MC dropout; 0: none."
        ),
    ] = 10,
    plant: Annotated[
        bool,
        typer.Option(
            "--plant", help="Plant failures in labels made from the truth of real logs, by seed."
        ),
    ] = False,
    variants: Annotated[
        int, typer.Option("--variants", min=1, max=MOST, help="Variants of each log (--plant).")
    ] = 50,
    seed: Annotated[
        int, typer.Option("--seed", min=0, max=MOST, help="Seed of failures and noise (--plant).")
    ] = 0,
    frames: Annotated[
        str, typer.Option("--frames", help="Frames A:B of each log, B excluded (--plant).")
    ] = "0:",
    share: Annotated[
        str, typer.Option("--share", help="Share of the scenes that fail, as 1/6 (--plant).")
    ] = "1/6",
    answer: Annotated[
        str,
        typer.Option("--answer", help="Form of the model's answers: points or boxes (--plant)."),
    ] = "points",
    listed: Annotated[
        Path | None,
        typer.Option("--planted", help="Write the planted failures to this JSON file (--plant)."),
    ] = None,
    draws: Annotated[
        int,
        typer.Option("--draws", min=0, max=MOST, help="Draws of the bootstrap; 0: no intervals."),
    ] = 1000,
    mining: MiningOptions,
    json: Json = False,
    config: Config = None,
    force: Force = False,
) -> None:
    """Measure how well contradictions find failures, compared with other rankings."""
    if only not in (None, *TABLES):
        raise UsageError(f"--table must be planted or natural, got {only!r}")
    if report is not None:
        need_writable(report, option="--report", force=force)
    planting = planting_of(variants=variants, seed=seed, frames=frames, share=share, answer=answer)
    if listed is not None:
        need_writable(listed, option="--planted", force=force)
    if listed is not None and not plant:
        raise UsageError("--planted lists what --plant plants: give --plant, or leave it out")
    if plant and only is not None:
        raise UsageError("--plant has one table: leave --table out")
    if kept is not None:
        need_folder(kept, option="--kept")
    logs_url = url if truth is not None else f"{url.rstrip('/')}/logs"
    where = _beside(url) if truth is None else truth
    if truth is None and not where.is_dir():
        raise UsageError(
            f"{url} is no fleet of `simulate`, it has no truth/: name one with --truth"
        )
    settings = settings_for(
        config,
        bucket=logs_url,
        **mining.flags(),
    )
    if plant:
        from workers.lab.evaluation.failures.planting.bench import bench_planting

        with progress() as bar:
            task = bar.add_task("mining", total=None)
            made, planted = bench_planting(
                logs_url,
                where,
                settings.mining(),
                planting,
                processes=workers,
                kept=settings.state / "bench" if kept is None else kept,
                draws=draws,
                on_progress=lambda done, total: bar.update(task, completed=done, total=total),
            )
        if listed is not None:
            save_text(planted.model_dump_json(indent=1), listed, option="--planted", force=force)
            remark(f"planted failures: {listed}")
        _say(made, json=json, report=report, force=force)
        return
    from workers.lab.evaluation.failures.bench import bench_failures
    from workers.lab.evaluation.failures.uncertainty import Probing

    with progress() as bar:
        task = bar.add_task("mining", total=None)
        bench = bench_failures(
            logs_url,
            where,
            settings.mining(),
            tables=TABLES if only is None else (only,),
            processes=workers,
            kept=settings.state / "bench" if kept is None else kept,
            slip_logs=slip_logs,
            probing=Probing(dropout_every=probe_every, second=str(second or "")),
            draws=draws,
            on_progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    _say(bench, json=json, report=report, force=force)


def _say(bench: "FailureBench", *, json: bool, report: Path | None, force: bool) -> None:
    """Print a benchmark, and write its report if one is wanted."""
    if json:
        json_line(bench.as_json())
    else:
        _say_what_it_is_too_small_for(bench)
        if bench.planted is not None and bench.variants:
            say_variants(bench, bench.planted)
        elif bench.planted is not None:
            _say_planted(bench.planted)
        if bench.natural is not None:
            _say_natural(bench.natural)
        if not bench.variants:
            remark(COLUMNS_MEAN)
    for judged_in, stream in bench.judged.items():
        remark(f"evaluated in {judged_in}: supervised stream {stream}")
    if report is None:
        remark("a page with plots and a description of each kind: --report FILE.html")
    else:
        write_report(report, bench, force=force)
        remark(f"report: {report}")


def _beside(url: str) -> Path:
    """Return the folder with the truth of a fleet, which must lie on this machine.

    Raises:
        UsageError: If the fleet lies elsewhere.
    """
    parts = urlsplit(url)
    if parts.scheme not in ("", "file"):
        raise UsageError(
            f"truth is read from a folder: copy {url}/truth here, and name it, --truth"
        )
    return Path(unquote(parts.path) if parts.scheme else url) / "truth"


COLUMNS = ("ranked by", "AP", "95 %", "precision 5 %", "recall 1 %", "5 %", "10 %", "lift 5 %")


def _say_planted(found: "PlantedTable") -> None:
    table(
        f"planted: {counted(found.failures, 'failure')} in {found.failing_scenes} of "
        f"{counted(found.scenes, 'scene')}",
        (*COLUMNS, "found per minute", "found area"),
        [_row("score", found)] + [_row(name, row) for name, row in _best_first(found.baselines)],
    )
    table(
        "by kind of failure, against scenes without failure",
        ("kind", "scenes", "AP", "recall 5 %", "10 %", "median rank"),
        (
            (
                *(kind, row.scenes, row.ap, row.recall_at["5"], row.recall_at["10"]),
                row.median_rank_share,
            )
            for kind, row in found.kinds.items()
        ),
    )
    shares = dict(found.disturbances) | ({"slips": found.slips} if found.slips else {})
    table(
        "false alarms: scenes without failure above the 5 % budget of undisturbed scenes",
        ("disturbed by", "scenes", "above", "share"),
        ((name, row.scenes, row.above, row.share) for name, row in shares.items()),
    )
    _say_who(found.attribution)
    remark(
        f"by object, where labels that lie on no object are no error: balanced accuracy "
        f"{found.attribution_by_object.accuracy}; {BY_OBJECT}"
    )
    shared = found.common_mode
    remark(
        f"gain over {found.best_baseline}: {found.gain} {found.gain_interval or ''}; "
        f"the labels show {found.planted - found.unseen} of {found.planted} planted failures; both "
        f"streams are wrong on {shared.both_wrong} of {shared.planted} common-mode ones, and "
        f"{shared.surfaced} of these are in the first 10 % with the witness against both"
    )


def _say_natural(found: "NaturalTable") -> None:
    table(
        f"natural: the stream fails on {found.failing_things} of {found.things} objects, in "
        f"{found.failing_scenes} of {counted(found.scenes, 'scene')}",
        (*COLUMNS, "found per minute", "found area"),
        [_row("strength", found)] + [_row(name, row) for name, row in _best_first(found.baselines)],
    )
    table(
        "by class",
        ("objects", "count", "failing", "failing and contradicting"),
        ((name, row.things, row.failing, row.found) for name, row in found.classes.items()),
    )
    _say_who(found.attribution)


def _say_who(said: "AttributionAccuracy") -> None:
    table(
        f"attribution: balanced accuracy {said.accuracy}, of a constant answer {said.commonest}",
        ("true", "tracks", "recall", *(f"attributed: {name}" for name in said.cases)),
        (
            (name, count, said.recall[name], *said.confusion[name].values())
            for name, count in said.cases.items()
        ),
    )


def _say_what_it_is_too_small_for(bench: "FailureBench") -> None:
    """Warn about figures for which the fleet is too small."""
    from workers.lab.evaluation.failures.intervals import MIN_LOGS
    from workers.lab.evaluation.failures.retrieval import budget_size

    if bench.logs < MIN_LOGS and not bench.within:
        remark(f"no intervals: {counted(bench.logs, 'log')}, and at least {MIN_LOGS} are needed")
    for ranked, what in ((bench.planted, "scene"), (bench.natural, "object")):
        if ranked is not None and budget_size(0.01, ranked.ranked) == budget_size(
            0.05, ranked.ranked
        ):
            remark(
                f"{counted(ranked.ranked, what)}: budgets of 1 % and 5 % contain the same, and "
                "each one changes the figures"
            )


def _row(name: str, row: "RankingRow") -> tuple[Any, ...]:
    interval = "" if row.ap_interval is None else f"{row.ap_interval[0]} to {row.ap_interval[1]}"
    recall = [row.recall_at[budget] for budget in ("1", "5", "10")]
    rest = (row.lift_at["5"], row.found_per_minute_at["5"], row.found_area)
    return (name, row.ap, interval, row.precision_at["5"], *recall, *rest)


def _best_first(rows: "dict[str, RankingRow]") -> "list[tuple[str, RankingRow]]":
    return sorted(rows.items(), key=lambda each: -(each[1].ap or 0.0))
