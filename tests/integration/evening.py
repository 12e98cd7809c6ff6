"""What a day has left, from whoever may be asked, beside what a fresh run finds in the bucket."""

import json
import os
import subprocess
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

from sqlalchemy import func, select

from service.api.stored_overlays import read_overlay
from service.curation.rates import RatesBy, RatesRequest, rates
from service.store.engine import open_store_to_read
from service.store.ledger import Ledger
from service.store.tables import LEASES, PLANS, RECORDINGS, SCENES, SHARDS
from tests.integration.daemons import QUICK, command
from tests.integration.day_watchers import Records

NOT_THE_SAME = {
    "plan_range_reads", "plan_bytes_read", "mine_range_reads", "mine_bytes_read",
    "peak_memory_bytes",
}  # fmt: skip
"""Of a log's status: what was read to come there, not what was found."""


@dataclass(frozen=True, slots=True)
class Found:
    """All that can be seen of one state.

    Attributes:
        top: Lines of `top --json`.
        records: Of the current scenes.
        overlays: Scene id to overlay.
        rates: Rows, by what they are grouped by.
        logs: Log id to what `status` says of it.
    """

    top: str
    records: Records
    overlays: dict[str, bytes]
    rates: dict[str, list[dict[str, Any]]]
    logs: dict[str, dict[str, Any]]


@dataclass(slots=True)
class Tally:
    """What has happened in a day.

    Attributes:
        changes: To the bucket, by kind.
        kills: Of processes, by what.
        ended: Processes that ended by themselves, and were started again.
        leases: Ends that leases had, by reason.
        superseded: Revisions that were planned and gave way to another, or went.
        withdrawn: Scenes in the ledger that are no longer current.
        adopted: Shards taken over from another revision.
        mined: Shards that were mined.
        events: Of scenes, by number.
    """

    changes: Counter[str] = field(default_factory=Counter)
    kills: Counter[str] = field(default_factory=Counter)
    ended: Counter[str] = field(default_factory=Counter)
    leases: Counter[str] = field(default_factory=Counter)
    superseded: int = 0
    withdrawn: int = 0
    adopted: int = 0
    mined: int = 0
    events: int = 0

    def lines(self) -> Iterator[str]:
        """Tell it to a person."""
        yield f"changes   {_listed(self.changes)}"
        yield f"kills     {_listed(self.kills)}"
        yield f"ended     {_listed(self.ended)}"
        yield f"leases    {_listed(self.leases)}"
        yield (
            f"ledger    {self.superseded} revisions superseded, {self.withdrawn} scenes withdrawn, "
            f"{self.mined} shards mined, {self.adopted} adopted, {self.events} events"
        )


@dataclass(frozen=True, slots=True)
class Evening:
    """The end of a day.

    Attributes:
        lived: The state that lived through it.
        fresh: That of a run which saw only the bucket's last state.
        heard: Who listened to what they hold.
        tally: What happened.
        watched: Withdrawals that were heard all day.
    """

    lived: Found
    fresh: Found
    heard: Mapping[str, Records]
    tally: Tally
    watched_withdrawals: int

    def differences(self) -> list[str]:
        """Say everything in which the day's end is not what a fresh run finds; best: nothing."""
        fresh, lived = self.fresh, self.lived
        return [
            *(["top --json tells other lines"] if lived.top != fresh.top else []),
            *_between("the ledger's records", lived.records, fresh.records),
            *(
                line
                for who, records in self.heard.items()
                for line in _between(who, records, fresh.records)
            ),
            *_between("overlays", lived.overlays, fresh.overlays),
            *_between("rates by", lived.rates, fresh.rates),
            *_between("status of", lived.logs, fresh.logs),
        ]


def found_in(state: Path, *, top: Sequence[str], env: Mapping[str, str]) -> Found:
    """Look at a state, beside its service or without one.

    Args:
        state: Folder of it.
        top: How to ask for `top`: the state, or its service.
        env: More variables.
    """
    with closing(open_store_to_read(state)) as store:
        ledger = Ledger(store, now_s=lambda: 0.0)
        scenes = ledger.current_scenes()
        groups: Sequence[RatesBy] = get_args(RatesBy)
        return Found(
            top=counterpoint("top", "--json", *top, env=env),
            records={scene.scene_id: scene.record for scene in scenes},
            overlays={
                scene.scene_id: read_overlay(str(state / "artifacts"), scene) for scene in scenes
            },
            rates={
                by: [row.model_dump() for row in rates(ledger.rate_sums(RatesRequest(by=by)), by)]
                for by in groups
            },
            logs={
                log.log_id: log.model_dump(mode="json", exclude=NOT_THE_SAME)
                for log in ledger.status().logs
            },
        )


def mined_afresh(state: Path, bucket: str, *, env: Mapping[str, str]) -> Found:
    """Mine a bucket as it lies there, with a state that knows nothing."""
    counterpoint("run", "--once", "--bucket", bucket, "--state", str(state), env=env)
    return found_in(state, top=("--state", str(state)), env=env)


def count_up(tally: Tally, state: Path) -> None:
    """Add what the ledger remembers of the day."""
    with closing(open_store_to_read(state)) as store, store.reading() as connection:
        ends = select(LEASES.c.ended_by, func.count()).where(~LEASES.c.is_held)
        for reason, times in connection.execute(ends.group_by(LEASES.c.ended_by)):
            tally.leases[reason] += times
        planned = select(PLANS.c.log_id).where(
            PLANS.c.log_id == RECORDINGS.c.log_id,
            PLANS.c.revision == RECORDINGS.c.revision,
            PLANS.c.state == "done",
        )
        for name, counted in {
            "superseded": select(func.count())
            .select_from(RECORDINGS)
            .where(~RECORDINGS.c.is_current, planned.exists()),
            "withdrawn": select(func.count()).select_from(SCENES).where(~SCENES.c.is_current),
            "adopted": select(func.count()).select_from(SHARDS).where(SHARDS.c.adopted_from != ""),
            "mined": select(func.count())
            .select_from(SHARDS)
            .where(SHARDS.c.adopted_from == "", SHARDS.c.state == "done"),
        }.items():
            setattr(tally, name, connection.execute(counted).scalar_one())
        tally.events = Ledger(store, now_s=lambda: 0.0).last_seq()


def counterpoint(*arguments: str, env: Mapping[str, str]) -> str:
    """Run the command, and return what it prints.

    Raises:
        AssertionError: If it fails; with its own words.
    """
    ended = subprocess.run(
        command(*arguments),
        env=os.environ | QUICK | dict(env),
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, f"{' '.join(arguments)}: {ended.stderr[-3000:]}"
    return ended.stdout


def _between(what: str, lived: Mapping[str, Any], fresh: Mapping[str, Any]) -> Iterator[str]:
    for name in sorted(lived.keys() | fresh.keys()):
        if name not in fresh:
            yield f"{what}: {name} should be gone"
        elif name not in lived:
            yield f"{what}: {name} is missing"
        elif lived[name] != fresh[name]:
            yield f"{what}: {name} differs{_how(lived[name], fresh[name])}"


def _how(lived: Any, fresh: Any) -> str:
    if isinstance(lived, bytes):
        return ""
    return f": {json.dumps(lived)} instead of {json.dumps(fresh)}"


def _listed(counted: Counter[str]) -> str:
    return ", ".join(f"{times} {what}" for what, times in sorted(counted.items())) or "none"
