"""Verb `eval shards`: dependence of labels on the cuts between shards."""

from typing import Annotated

import typer

from service.cli.options import (
    BucketOfLogs,
    Config,
    Json,
    SelfSupervised,
    ShardSeconds,
    settings_for,
)
from service.cli.output import json_line, progress, table


def shards(
    bucket: BucketOfLogs,
    shard_seconds: ShardSeconds = None,
    warmup_seconds: Annotated[
        float | None,
        typer.Option("--warmup-seconds", help="Warm-up before a window, seconds; default 1.2."),
    ] = None,
    selfsupervised: SelfSupervised = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Compare the labels of every log in shards with those of the whole log, per point."""
    settings = settings_for(
        config,
        bucket=bucket,
        selfsupervised=selfsupervised,
        shard_seconds=shard_seconds,
        warmup_seconds=warmup_seconds,
    )
    from workers.lab.evaluation.motion.shard_consistency import FROM_S, evaluate_shards

    with progress() as bar:
        task = bar.add_task("evaluating", total=None)
        evaluated = evaluate_shards(
            bucket,
            settings=settings.mining(),
            on_progress=lambda done: bar.update(task, completed=done),
        )
    if json:
        for row in evaluated:
            json_line(row)
        return
    seconds = [str(each) for each in FROM_S if str(each) in evaluated[-1].equal_by_second]
    table(
        "share of the points with the same label in shards as in the whole log: in all windows; "
        "and of windows with a warm-up, from so many seconds after they began",
        ("log", "shards", "points", "all", *(f"from {second} s on" for second in seconds)),
        (
            (
                row.log,
                row.shards,
                row.points,
                f"{row.equal_share:.5f}",
                *(_share(row.equal_by_second.get(second)) for second in seconds),
            )
            for row in evaluated
        ),
    )


def _share(value: float | None) -> str | None:
    return None if value is None else f"{value:.5f}"
