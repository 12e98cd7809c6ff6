"""The commands of the runbook for a PostgreSQL, as they are there: made, copied and restored."""

import os
import re
import shutil
import subprocess
from contextlib import closing
from pathlib import Path

import pytest

from service.settings.config import load_settings
from service.store.opening import open_ledger_store, open_ledger_store_to_read
from service.store.served_bucket import note_served, served_bucket
from tests.integration.postgres_server import Postgres, postgres_server

pytestmark = pytest.mark.integration

RUNBOOK = (Path(__file__).parents[2] / "deploy" / "README.md").read_text(encoding="utf-8")


def run(commands: str, server: Postgres, folder: Path) -> None:
    """Run a block of the runbook against a server that asks for no password."""
    if shutil.which(commands.split()[0]) is None:
        pytest.skip("needs Debian's package `postgresql-client`")
    said = commands.replace("db.fleet.lan", "127.0.0.1").replace(" --pwprompt", "")
    said = said.replace("/backup/", f"{folder}/").replace("--username postgres", "--username app")
    environ = os.environ | {"PGPORT": str(server.port)}
    subprocess.run(["bash", "-ec", said], check=True, env=environ, timeout=60)


def test_a_database_is_made_copied_and_restored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = re.findall(r"```\n((?:createuser|pg_dump|dropdb) .*?)```", RUNBOOK, re.DOTALL)
    make, copy, restore = blocks
    (url,) = re.findall(r"^COUNTERPOINT_DATABASE=(\S+)$", RUNBOOK, re.MULTILINE)
    with postgres_server() as server:
        run(make, server, tmp_path)
        at = url.replace("db.fleet.lan:5432", f"127.0.0.1:{server.port}")
        monkeypatch.setenv("COUNTERPOINT_DATABASE", at)
        settings = load_settings(state=tmp_path)
        with closing(open_ledger_store(settings)) as store, store.writing() as connection:
            note_served(connection, "s3://fleet")
        run(copy, server, tmp_path)
        with closing(open_ledger_store(settings)) as store, store.writing() as connection:
            note_served(connection, "s3://later")
        run(restore, server, tmp_path)
        with closing(open_ledger_store_to_read(settings)) as store, store.reading() as connection:
            assert served_bucket(connection) == "s3://fleet"
        with closing(open_ledger_store(settings)) as store, store.writing() as connection:
            note_served(connection, "s3://later")
