"""What one transaction did, kept beside its connection and told once it is on disk."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final, Literal, Protocol

from sqlalchemy import Connection

from schemas.score import SceneScore
from schemas.work import Answer

WorkKind = Literal["plan", "shard"]
"""What a lease is for."""

CommitOutcome = Literal["stored", "repeated", "missing", "refused"]
"""How a commit was answered: taken; had been taken before; records wanting; void or wrong."""


@dataclass(slots=True)
class Effects:
    """What a transaction is about to change for good.

    Attributes:
        scenes: Scores stored for the first time.
        stored: Plans and shards finished for the first time, by kind.
        commits: Answers to commits, by kind and outcome.
        leases_ended: Leases ended, by reason as the ledger writes it.
        parked: Plans and shards that are not tried again, by kind.
        retried: Parked ones that are tried again after all, since a person asked for it, by kind.
    """

    scenes: list[SceneScore] = field(default_factory=list)
    stored: Counter[WorkKind] = field(default_factory=Counter)
    commits: Counter[tuple[WorkKind, CommitOutcome]] = field(default_factory=Counter)
    leases_ended: Counter[str] = field(default_factory=Counter)
    parked: Counter[WorkKind] = field(default_factory=Counter)
    retried: Counter[WorkKind] = field(default_factory=Counter)

    def note_commit(self, kind: WorkKind, answer: Answer, *, stored: bool) -> None:
        """Count the answer to one commit."""
        outcome: CommitOutcome = "stored" if stored else "repeated"
        if not answer.ok:
            outcome = "missing" if answer.missing else "refused"
        self.commits[kind, outcome] += 1


class StoreObserver(Protocol):
    """Whoever counts what happens to a store; called from any thread, and must be quick."""

    def on_effects(self, effects: Effects) -> None:
        """Take what a transaction did; it is on disk."""
        ...

    def on_database_error(self) -> None:
        """Note that a transaction could not be finished."""
        ...

    def on_damaged_record(self) -> None:
        """Note that a stored record is not what its digest says."""
        ...


def effects_of(connection: Connection) -> Effects:
    """Return what the transaction of this connection has noted so far, to note more."""
    effects: Effects | None = connection.info.get(_KEY)
    return begin_effects(connection) if effects is None else effects


def begin_effects(connection: Connection) -> Effects:
    """Start a transaction's notes: connections are used again, their notes are not."""
    effects = connection.info[_KEY] = Effects()
    return effects


def kind_of(shard: str) -> WorkKind:
    """Say what the work is, whose shard has this name; empty for a plan."""
    return "shard" if shard else "plan"


_KEY: Final = "counterpoint_effects"
