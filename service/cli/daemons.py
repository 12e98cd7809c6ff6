"""Verbs that stay: `run` is everything on one machine; `service`, `worker`, `router` its parts."""

from pathlib import Path
from typing import Annotated

import typer

from service.cli.output import progress, remark
from service.cli.report import say_what_was_found
from service.config import DEFAULT_ENDPOINT, Settings, load_settings
from service.errors import UsageError

BucketUrl = Annotated[
    str | None,
    typer.Option("--bucket", help="URL or path of the log bucket, else COUNTERPOINT_BUCKET."),
]
StateDir = Annotated[
    Path | None, typer.Option("--state", help="Folder of ledger and overlays; counterpoint-state.")
]
Artifacts = Annotated[str | None, typer.Option("--artifacts", help="URL for overlays.")]
Once = Annotated[bool, typer.Option("--once", help="Mine what is there, then stop.")]
ShardSeconds = Annotated[
    float | None, typer.Option("--shard-seconds", help="Length of a shard's window.")
]
Listen = Annotated[
    str | None, typer.Option("--listen", help="tcp/ADDRESS:PORT of the router; a free port.")
]
Connect = Annotated[
    str | None, typer.Option("--connect", help="tcp/HOST:PORT of the router; commas for several.")
]
Workers = Annotated[int | None, typer.Option("--workers", help="Worker processes; 2.")]
Supervised = Annotated[
    str | None, typer.Option("--supervised", help="salsanext-lmnet or recorded.")
]
SelfSupervised = Annotated[
    str | None, typer.Option("--selfsupervised", help="registration or two-stage.")
]


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    app.command(epilog="counterpoint run --bucket s3://fleet --state /var/lib/counterpoint")(run)
    app.command(epilog="counterpoint service --bucket s3://fleet --connect tcp/router:7447")(
        service
    )
    app.command(epilog="counterpoint worker --connect tcp/router:7447")(worker)
    app.command(epilog="counterpoint router --listen tcp/127.0.0.1:7447")(router)


def run(
    bucket: BucketUrl = None,
    state: StateDir = None,
    workers: Workers = None,
    once: Once = False,
    shard_seconds: ShardSeconds = None,
    listen: Listen = None,
    artifacts: Artifacts = None,
    supervised: Supervised = None,
    selfsupervised: SelfSupervised = None,
) -> None:
    """Run router, service and workers on this machine; watch the bucket, or mine it --once."""
    from service.embedded import run_embedded

    settings = load_settings(
        bucket=bucket,
        state=state,
        workers=workers,
        listen=listen,
        artifacts=artifacts,
        supervised=supervised,
        selfsupervised=selfsupervised,
        grid=None if shard_seconds is None else {"shard_s": shard_seconds},
    )
    need_bucket(settings)
    with progress() as bar:
        task = bar.add_task("mining", total=None)
        status = run_embedded(
            settings,
            once=once,
            on_ready=remark,
            on_progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    if once:
        say_what_was_found(status)


def service(
    bucket: BucketUrl = None,
    state: StateDir = None,
    connect: Connect = None,
    shard_seconds: ShardSeconds = None,
    artifacts: Artifacts = None,
    supervised: Supervised = None,
    selfsupervised: SelfSupervised = None,
) -> None:
    """Run the service alone: bucket watch, ledger, ranking. Needs a router and workers."""
    from service.embedded import run_service

    settings = load_settings(
        bucket=bucket,
        state=state,
        connect=connect,
        artifacts=artifacts,
        supervised=supervised,
        selfsupervised=selfsupervised,
        grid=None if shard_seconds is None else {"shard_s": shard_seconds},
    )
    need_bucket(settings)
    run_service(settings, on_ready=remark)


def worker(
    connect: Connect = None,
    workers: Annotated[int, typer.Option("--workers", help="Worker processes.")] = 1,
) -> None:
    """Run workers for a service elsewhere; they learn bucket and settings from it."""
    from service.embedded import run_workers

    run_workers(load_settings(connect=connect, workers=workers), on_ready=remark)


def router(listen: Listen = None, connect: Connect = None) -> None:
    """Run a Zenoh router alone; --connect links it to other routers."""
    from service.router import run_router

    settings = load_settings(listen=listen, connect=connect)
    run_router(settings.listen or DEFAULT_ENDPOINT, connect=settings.connect, on_ready=remark)


def need_bucket(settings: Settings) -> None:
    """Refuse to start without a bucket.

    Raises:
        UsageError: If no bucket is named.
    """
    if not settings.bucket:
        raise UsageError("no log bucket: give --bucket URL, or set COUNTERPOINT_BUCKET")
