"""Verb `retry`: tries parked work and refused logs again, once the cause is fixed."""

from typing import Annotated

import typer

from service.cli.options import Config, Connect, Database, Json, StateToRead
from service.cli.output import json_line, remark, table
from service.cli.scenes import reader
from service.errors import UsageError


def add_to(app: typer.Typer) -> None:
    """Add the verb of this file to the command."""
    app.command(epilog="counterpoint retry --all --connect tcp/127.0.0.1:7447")(retry)


def retry(
    log_ids: Annotated[
        list[str] | None,
        typer.Argument(metavar="[LOG_ID]...", help="Log ids, as listed by `counterpoint status`."),
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="Retry all parked work.")] = False,
    refused: Annotated[
        bool,
        typer.Option(
            "--refused",
            help="Plan all refused logs again, as when their predictions have come since.",
        ),
    ] = False,
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Try parked plans and shards again, with all their attempts; finished work stays done.

    Named logs that were refused are planned again, and their scenes whose overlays were deleted for
    the disk budget are mined again too.
    """
    if bool(log_ids) + everything + refused != 1:
        raise UsageError(
            "name the logs to retry, or give --all for all parked work, or --refused for all "
            "refused logs"
        )
    wanted = log_ids or None
    source = reader(config, connect=connect, state=state, database=database)
    retried = source.retry(wanted, refused=refused)
    if json:
        for work in retried:
            json_line(work)
    elif retried:
        table(
            f"{len(retried)} tried again",
            ("log", "shard", "attempts before", "error before"),
            ((work.log_id, work.shard, work.attempts, work.error) for work in retried),
        )
    without = sorted(set(wanted or ()) - {work.log_id for work in retried})
    for log_id in without:
        remark(f"nothing of {log_id} is parked or refused")
    if without:
        remark(
            "what is mined is not mined again; another answer of the model needs a folder of its "
            "own"
        )
    if not wanted and not retried:
        remark("nothing is refused" if refused else "nothing is parked")
