"""Migration of a database from any earlier version to this program's, in numbered steps."""

from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Final

from sqlalchemy import Connection, inspect, text

from service.errors import StateOutdatedError, StateUnusableError
from service.store.listed_scenes import list_stored_scenes
from service.store.same_bytes import fill_contents

STEPS: Final[tuple[str, ...]] = (
    "0001_ledger.sql",
    "0002_revisions.sql",
    "0003_ranking.sql",
    "0004_truncated.sql",
    "0005_write_proof.sql",
    "0006_retired_overlays.sql",
    "0007_served_bucket.sql",
    "0008_incarnation.sql",
    "0009_reading.sql",
    "0010_review.sql",
    "0011_layers.sql",
    "0012_audit.sql",
    "0013_webhooks.sql",
    "0014_service_lease.sql",
    "0015_lanes.sql",
    "0016_same_bytes.sql",
    "0017_ranges.sql",
)
"""Step i migrates version i to i + 1. A step that has been released is never edited."""

SCHEMA_VERSION: Final = len(STEPS)

_FILLED: Final[Mapping[str, Callable[[Connection], None]]] = {
    "0016_same_bytes.sql": fill_contents,
    "0017_ranges.sql": list_stored_scenes,
}
"""Steps that fill new tables from records, which SQL alone cannot read."""

_SPELLINGS: Final = {
    "sqlite": {
        "{blob}": "BLOB",
        "{true}": "1",
        "{false}": "0",
        "{bytewise}": "",
        "{rowid}": "INTEGER",
        "{without_rowid}": "WITHOUT ROWID",
    },
    "postgresql": {
        "{blob}": "BYTEA",
        "{true}": "TRUE",
        "{false}": "FALSE",
        "{bytewise}": 'COLLATE "C"',
        "{rowid}": "BIGINT",
        "{without_rowid}": "",
    },
}
"""SQL fragments that differ between the two servers; the steps are otherwise plain SQL. SQLite uses
a partial index only where its condition has the same spelling as in the query, hence `= 1` and `=
0`.
"""


def schema_version(connection: Connection) -> int:
    """Read the version of the schema; 0 for an empty database."""
    if not inspect(connection).has_table("schema_version"):
        return 0
    return int(connection.execute(text("SELECT max(version) FROM schema_version")).scalar_one())


def migrate(connection: Connection, *, name: str) -> None:
    """Run the pending steps of this database, all within the caller's transaction.

    Args:
        connection: In a transaction that writes.
        name: Name of the database, for the message.

    Raises:
        StateUnusableError: If a newer version of the program wrote it.
    """
    version = schema_version(connection)
    _refuse_newer(version, name=name)
    for number in range(version, SCHEMA_VERSION):
        for statement in _statements(STEPS[number], dialect=connection.dialect.name):
            connection.exec_driver_sql(statement)
        if (fill := _FILLED.get(STEPS[number])) is not None:
            fill(connection)
        connection.execute(
            text("INSERT INTO schema_version (version) VALUES (:version)"), {"version": number + 1}
        )


def require_current(connection: Connection, *, name: str) -> None:
    """Check that a database that is only read needs no migration.

    Raises:
        StateUnusableError: If its version is another; `StateOutdatedError` if it is older.
    """
    version = schema_version(connection)
    _refuse_newer(version, name=name)
    if version < SCHEMA_VERSION:
        raise StateOutdatedError(
            f"state has schema version {version}, this program reads {SCHEMA_VERSION} ({name}); "
            "start the service on it once to bring it up to date"
        )


def _refuse_newer(version: int, *, name: str) -> None:
    if version > SCHEMA_VERSION:
        raise StateUnusableError(
            f"state was written by a newer version: schema version {version}, this program knows "
            f"{SCHEMA_VERSION} ({name}); use the newer program or another --state folder"
        )


def _statements(step: str, *, dialect: str) -> list[str]:
    script = files(__package__).joinpath(step).read_text(encoding="utf-8")
    for placeholder, spelled in _SPELLINGS[dialect].items():
        script = script.replace(placeholder, spelled)
    lines = [line for line in script.splitlines() if not line.lstrip().startswith("--")]
    return [part.strip() for part in "\n".join(lines).split(";") if part.strip()]
