"""Report of parked work at the end of `run --once`: one line, and an exit code."""

import shlex
from collections import Counter
from typing import Final

from service.cli.output import command, counted
from service.curation.status import Status
from service.settings.config import DEFAULT_STATE, Settings

EX_PARKED: Final = 3
"""Exit code of `run --once` when all else is mined, but scenes of parked work are missing."""

MOST_NAMED: Final = 5
"""Logs named in one line."""


def parked_line(status: Status, settings: Settings) -> str:
    """Return a line on parked work, its logs and the command that retries it; else nothing."""
    if not status.parked:
        return ""
    shards = Counter(work.log_id for work in status.parked if work.shard)
    plans = Counter(work.log_id for work in status.parked if not work.shard)
    logs = sorted({*shards, *plans})
    what = [
        counted(sum(works.values()), kind)
        for works, kind in ((shards, "shard"), (plans, "plan"))
        if works
    ]
    named = ", ".join(
        f"{log_id} ({counted(shards[log_id], 'shard') if shards[log_id] else 'not planned'})"
        for log_id in logs[:MOST_NAMED]
    )
    more = f" and {len(logs) - MOST_NAMED} more" if len(logs) > MOST_NAMED else ""
    return (
        f"error: {' and '.join(what)} of {counted(len(logs), 'log')} parked, their scenes are "
        f"missing: {named}{more}; fix the cause reported above, then run "
        f"`{retry_command(settings)}` and the same command again"
    )


def retry_command(settings: Settings) -> str:
    """Return the command that retries parked work of this state, without a password."""
    words = [command(), "retry", "--all"]
    if settings.state != DEFAULT_STATE:
        words += ["--state", str(settings.state)]
    return shlex.join(words)
