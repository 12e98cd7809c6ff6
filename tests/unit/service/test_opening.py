"""Which database is opened follows from the settings, and what cannot be opened is said."""

import sys
from contextlib import closing
from pathlib import Path

import pytest

from service.cli.main import main
from service.errors import StateUnusableError
from service.settings.config import Settings
from service.store.engine import DATABASE_NAME, StoreUnavailableError
from service.store.opening import open_ledger_store, open_ledger_store_to_read, sole_service
from tests.needed import needed

NOBODY = "postgresql+psycopg://me:geheim@127.0.0.1:9/x"


def test_without_a_url_it_is_a_file_in_the_state_folder(tmp_path: Path) -> None:
    settings = Settings(state=tmp_path)
    with pytest.raises(StateUnusableError, match="no state to read"):
        open_ledger_store_to_read(settings)
    with closing(open_ledger_store(settings)):
        assert (tmp_path / DATABASE_NAME).is_file()
    with sole_service(settings) as sole:
        assert sole is None


def test_a_server_that_does_not_answer_means_try_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    needed("psycopg", "the extra `postgres`")
    settings = Settings(state=tmp_path, database=NOBODY)
    for opening in (open_ledger_store, open_ledger_store_to_read, sole_service):
        with pytest.raises(StoreUnavailableError, match="cannot use the database") as refused:
            opening(settings)
        assert "geheim" not in str(refused.value)
    monkeypatch.setenv("COUNTERPOINT_DATABASE", NOBODY)
    assert main(["top"]) == 75
    assert "geheim" not in capsys.readouterr().err


def test_without_the_driver_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    settings = Settings(state=tmp_path, database=NOBODY)
    for opening in (open_ledger_store, open_ledger_store_to_read, sole_service):
        with pytest.raises(StateUnusableError, match=r"pip install 'counterpoint\[postgres\]'"):
            opening(settings)
