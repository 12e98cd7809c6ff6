"""Effects of one transaction, collected per connection and reported once it is on disk."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final, Literal, Protocol

from sqlalchemy import Connection

from schemas.score import SceneScore
from schemas.verdict import Verdict
from schemas.work import Answer

WorkKind = Literal["plan", "shard"]
"""Kind of the work of a lease."""

CommitOutcome = Literal["stored", "repeated", "missing", "refused"]
"""Outcome of a commit. `stored`: accepted. `repeated`: accepted before. `missing`: records are
missing. `refused`: void or wrong.
"""


@dataclass(slots=True)
class Effects:
    """Effects of a transaction.

    Attributes:
        scenes: Scores stored for the first time.
        stored: Plans and shards finished for the first time, by kind.
        commits: Answers to commits, by kind and outcome.
        leases_ended: Leases ended, by the reason in the ledger.
        parked: Plans and shards that are not retried, by kind.
        retried: Parked ones that are retried on request, by kind.
        verdicts: Verdicts stored, by value.
    """

    scenes: list[SceneScore] = field(default_factory=list)
    stored: Counter[WorkKind] = field(default_factory=Counter)
    commits: Counter[tuple[WorkKind, CommitOutcome]] = field(default_factory=Counter)
    leases_ended: Counter[str] = field(default_factory=Counter)
    parked: Counter[WorkKind] = field(default_factory=Counter)
    retried: Counter[WorkKind] = field(default_factory=Counter)
    verdicts: Counter[Verdict] = field(default_factory=Counter)

    def note_commit(self, kind: WorkKind, answer: Answer, *, stored: bool) -> None:
        """Count the answer to one commit."""
        outcome: CommitOutcome = "stored" if stored else "repeated"
        if not answer.ok:
            outcome = "missing" if answer.missing else "refused"
        self.commits[kind, outcome] += 1


class StoreObserver(Protocol):
    """Observer of a store; called from any thread, and must be quick."""

    def on_effects(self, effects: Effects) -> None:
        """Receive the effects of a transaction that is on disk."""
        ...

    def on_database_error(self) -> None:
        """Receive the notice of a failed transaction."""
        ...

    def on_damaged_record(self) -> None:
        """Receive the notice of a stored record that does not match its digest."""
        ...


def effects_of(connection: Connection) -> Effects:
    """Return the effects of this connection's transaction so far, to add to them."""
    effects: Effects | None = connection.info.get(_KEY)
    return begin_effects(connection) if effects is None else effects


def begin_effects(connection: Connection) -> Effects:
    """Start a transaction with empty effects, since connections are reused."""
    effects = connection.info[_KEY] = Effects()
    return effects


def kind_of(shard: str) -> WorkKind:
    """Return the kind of work of a shard's name; empty for a plan."""
    return "shard" if shard else "plan"


_KEY: Final = "counterpoint_effects"
