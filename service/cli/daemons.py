"""Verbs of daemons: `run` starts all parts; `service`, `worker`, `router` start one each."""

from typing import Annotated

import typer

from service.cli.option_groups import MiningOptions, grouped
from service.cli.options import (
    Artifacts,
    BucketUrl,
    Config,
    Connect,
    Database,
    Exclude,
    Include,
    LogFormat,
    LogLevel,
    Model,
    Predictions,
    ShardSeconds,
    StateDir,
    Weights,
    settings_for,
)
from service.cli.output import command, progress, remark
from service.cli.parked import EX_PARKED, parked_line
from service.cli.report import say_what_was_found
from service.errors import UsageError
from service.security.listening import need_locked_bus
from service.settings.config import DEFAULT_ENDPOINT, Settings

Once = Annotated[bool, typer.Option("--once", help="Mine the logs now in the bucket, then stop.")]
Remine = Annotated[
    str | None,
    typer.Option(
        "--remine",
        help="Logs mined again under a new pipeline version: newest (all), selected, none.",
    ),
]
RemineHours = Annotated[
    float | None,
    typer.Option(
        "--remine-core-hours-a-day", help="Core-hours a day for mining again; 0: no limit."
    ),
]
RemineCanary = Annotated[
    float | None,
    typer.Option("--remine-canary-share", help="Share of these logs that is finished first."),
]
DryRun = Annotated[
    bool,
    typer.Option(
        "--dry-run",
        help="List logs, the work left and its estimated hours; write nothing.",
    ),
]
Listen = Annotated[
    str | None,
    typer.Option("--listen", help="tcp/ADDRESS:PORT of the router; default: a free port."),
]
Workers = Annotated[int | None, typer.Option("--workers", help="Worker processes; default 2.")]


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    app.command(epilog="counterpoint run --bucket s3://fleet --state /var/lib/counterpoint")(run)
    app.command(epilog="counterpoint service --bucket s3://fleet --connect tcp/router:7447")(
        service
    )
    app.command(
        epilog="counterpoint worker --connect tcp/router:7447 --bucket s3://fleet "
        "--artifacts s3://fleet-overlays --workers 8"
    )(worker)
    app.command(epilog="counterpoint router --listen tcp/127.0.0.1:7447")(router)


@grouped
def run(
    *,
    bucket: BucketUrl = None,
    state: StateDir = None,
    workers: Workers = None,
    once: Once = False,
    dry_run: DryRun = False,
    review: Annotated[
        bool, typer.Option("--review", help="Serve the review page too, a process of its own.")
    ] = False,
    shard_seconds: ShardSeconds = None,
    include: Include = None,
    exclude: Exclude = None,
    listen: Listen = None,
    artifacts: Artifacts = None,
    database: Database = None,
    remine: Remine = None,
    remine_core_hours_a_day: RemineHours = None,
    remine_canary_share: RemineCanary = None,
    mining: MiningOptions,
    config: Config = None,
    log_format: LogFormat = None,
    log_level: LogLevel = None,
    json: Annotated[bool, typer.Option("--json", help="With --dry-run: JSON on stdout.")] = False,
) -> None:
    """Run router, service and workers on this machine; watch the bucket, or mine it --once.

    With --once the exit code is 3 if work is parked: all else is mined, but its scenes are missing.
    """
    settings = settings_for(
        config,
        bucket=bucket,
        state=state,
        workers=workers,
        shard_seconds=shard_seconds,
        include=include,
        exclude=exclude,
        listen=listen,
        artifacts=artifacts,
        database=database,
        remine=remine,
        remine_core_hours_a_day=remine_core_hours_a_day,
        remine_canary_share=remine_canary_share,
        **mining.flags(),
        log_format=log_format,
        log_level=log_level,
    )
    need_bucket(settings)
    if dry_run:
        _dry_run(settings, as_json=json)
        return
    if json:
        raise UsageError("--json is for --dry-run; a run logs: --log-format json")
    from service.cli.review import need_extra, review_process
    from service.embedded import run_embedded

    page = None
    if review:
        need_extra()
        page = review_process(
            {
                "state": settings.state,
                "database": database,
                "artifacts": artifacts,
                "config": config,
                "log_format": log_format,
                "log_level": log_level,
            }
        )
    with progress() as bar:
        task = bar.add_task("mining", total=None)
        status = run_embedded(
            settings,
            once=once,
            remark=remark,
            page=page,
            on_progress=lambda what, done, total: bar.update(
                task, description=what, completed=done, total=total
            ),
        )
    if once:
        say_what_was_found(status)
        remark(f"next: {command()} top --state {settings.state}")
        if parked := parked_line(status, settings):
            remark(parked, level="error")
            raise typer.Exit(EX_PARKED)


@grouped
def service(
    *,
    bucket: BucketUrl = None,
    state: StateDir = None,
    connect: Connect = None,
    standby: Annotated[
        bool,
        typer.Option("--standby", help="One of two on a PostgreSQL: wait, or have one wait."),
    ] = False,
    shard_seconds: ShardSeconds = None,
    include: Include = None,
    exclude: Exclude = None,
    artifacts: Artifacts = None,
    database: Database = None,
    remine: Remine = None,
    remine_core_hours_a_day: RemineHours = None,
    remine_canary_share: RemineCanary = None,
    mining: MiningOptions,
    config: Config = None,
    log_format: LogFormat = None,
    log_level: LogLevel = None,
) -> None:
    """Run the service alone: bucket watch, ledger, ranking. It needs a router and workers.

    With --standby a second one on the same --database takes over when the first one ends or hangs.
    """
    from service.alone import run_service

    settings = settings_for(
        config,
        bucket=bucket,
        state=state,
        connect=connect,
        standby=standby or None,
        shard_seconds=shard_seconds,
        include=include,
        exclude=exclude,
        artifacts=artifacts,
        database=database,
        remine=remine,
        remine_core_hours_a_day=remine_core_hours_a_day,
        remine_canary_share=remine_canary_share,
        **mining.flags(),
        log_format=log_format,
        log_level=log_level,
    )
    need_bucket(settings)
    run_service(settings, remark=remark)


def worker(
    connect: Connect = None,
    workers: Workers = None,
    pool: Annotated[
        str | None, typer.Option("--pool", help="local, or ray: actors of a Ray cluster.")
    ] = None,
    ray_address: Annotated[
        str | None, typer.Option("--ray-address", help="Of the Ray cluster; default auto.")
    ] = None,
    ray_most_workers: Annotated[
        int | None, typer.Option("--ray-most-workers", help="Most workers, by the work that waits.")
    ] = None,
    bucket: BucketUrl = None,
    artifacts: Artifacts = None,
    model: Model = None,
    weights: Weights = None,
    predictions: Predictions = None,
    config: Config = None,
    log_format: LogFormat = None,
    log_level: LogLevel = None,
) -> None:
    """Run workers for a service elsewhere; it sends them the bucket and the mining settings.

    Where the router is on another machine, the workers read only the --bucket that is named here.
    They write only to its --artifacts, and read only its --model, --weights and --predictions, or
    files in them.
    """
    from service.embedded import run_workers

    settings = settings_for(
        config,
        connect=connect,
        workers=workers,
        pool=pool,
        ray_address=ray_address,
        ray_most_workers=ray_most_workers,
        bucket=bucket,
        artifacts=artifacts,
        model=model,
        weights=weights,
        predictions=predictions,
        supervised="recorded" if predictions else None,
        log_format=log_format,
        log_level=log_level,
    )
    run_workers(settings, remark=remark)


def router(
    listen: Listen = None,
    connect: Connect = None,
    config: Config = None,
    log_format: LogFormat = None,
    log_level: LogLevel = None,
) -> None:
    """Run a Zenoh router alone; --connect links it to other routers."""
    from service.router import run_router

    settings = settings_for(config, listen=listen, log_format=log_format, log_level=log_level)
    listens = settings.listen or DEFAULT_ENDPOINT
    need_locked_bus(settings, listens=listens.split(","))
    run_router(
        listens,
        locks=settings.locks,
        connect=connect or "",  # the setting, in a file that all processes share, may be ourselves
        remark=remark,
        heartbeat_s=settings.heartbeat_s,
    )


def need_bucket(settings: Settings) -> None:
    """Refuse to start without a bucket.

    Raises:
        UsageError: If the settings name no bucket.
    """
    if not settings.bucket:
        raise UsageError(
            "no log bucket: give --bucket URL, set COUNTERPOINT_BUCKET, or write `bucket` in the "
            "settings file"
        )


def _dry_run(settings: Settings, *, as_json: bool) -> None:
    from service.cli.output import json_line
    from service.cli.report import say_dry_run
    from service.dry_run import plan_dry_run

    with progress() as bar:
        task = bar.add_task("reading indexes of logs", total=None)
        found = plan_dry_run(
            settings,
            on_progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    if as_json:
        json_line(found)
    else:
        say_dry_run(found)
