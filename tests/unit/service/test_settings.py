"""Settings come in layers, say where they come from, and refuse what cannot be meant."""

import json
import os
from pathlib import Path

import pytest

from service.cli.main import main
from service.errors import UsageError
from service.settings.config import Settings, cache_folder, load_settings, read_settings
from service.settings.table import setting_rows

SECRET = "geheim"  # noqa: S105  # what must be seen nowhere


@pytest.fixture(autouse=True)
def _no_settings_from_outside(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in [name for name in os.environ if name.startswith("COUNTERPOINT_")]:
        monkeypatch.delenv(name)
    monkeypatch.chdir(tmp_path)


def settings_file(text: str) -> Path:
    file = Path("fleet.toml")
    file.write_text(text, encoding="utf-8")
    return file


def test_flags_win_over_variables_and_these_over_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    file = settings_file('workers = 3\nbucket = "from-file"\nroot = "r"\n[grid]\nshard_s = 10\n')
    monkeypatch.setenv("COUNTERPOINT_BUCKET", "from-variable")
    monkeypatch.setenv("COUNTERPOINT_WORKERS", "4")
    read = read_settings(config=file, workers=5, state=None)
    held = {row.setting: (row.value, row.origin) for row in setting_rows(read)}
    assert held["workers"] == (5, "--workers")
    assert held["bucket"] == ("from-variable", "COUNTERPOINT_BUCKET")
    assert held["root"] == ("r", "fleet.toml:root")
    assert held["grid.shard_s"] == (10.0, "fleet.toml:grid.shard_s")
    assert held["grid.scene_s"] == (2.0, "default")
    assert read.settings.mining().grid.shard_s == 10


def test_a_variable_names_the_file_and_a_flag_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COUNTERPOINT_CONFIG", str(settings_file("workers = 7")))
    assert load_settings().workers == 7
    Path("other.toml").write_text("workers = 8", encoding="utf-8")
    assert load_settings(config=Path("other.toml")).workers == 8
    monkeypatch.setenv("COUNTERPOINT_CONFIG", "")
    assert load_settings().workers == 2


@pytest.mark.parametrize("written", ["car-*,bus-*", '["car-*", "bus-*"]', " car-* , bus-* "])
def test_a_variable_may_hold_a_list(written: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COUNTERPOINT_INCLUDE", written)
    assert load_settings().include == ("car-*", "bus-*")


def test_a_pattern_in_brackets_is_no_json(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COUNTERPOINT_INCLUDE", "[ab]*")
    assert load_settings().include == ("[ab]*",)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        pytest.param("workrs = 3", "unknown setting workrs; did you mean workers?", id="typo"),
        pytest.param("shard_s = 9", "did you mean grid.shard_s?", id="not in its table"),
        pytest.param("[grid]\nshards = 9", "unknown setting grid.shards; did you", id="in a table"),
        pytest.param("[nonsense]\nx = 1", "unknown setting nonsense.x", id="unknown table"),
        pytest.param("grid = 5", "grid is a table: write [grid]", id="table as value"),
        pytest.param("workers = ", "is not TOML: ", id="no TOML"),
        pytest.param("workers = true", "fleet.toml: workers = true: is not a boolean", id="yes"),
        pytest.param("lease_s = inf", "lease_s = inf: must be a number above 1", id="endless"),
        pytest.param("workers = 0", "fleet.toml: workers = 0: must be a whole number", id="zero"),
        pytest.param('log_level = "loud"', 'log_level = "loud": must be debug or', id="no level"),
        pytest.param('supervised = "nosuch"', "must be one of salsanext-lmnet, ", id="no part"),
        pytest.param('witness = "nosuch"', "must be one of free-space, none", id="no witness"),
        pytest.param("vehicles = 5", "vehicles = 5: must be a list of at most 50", id="no list"),
        pytest.param(
            "[grid]\nshard_s = 3", "grid.shard_s = 3: shard_s (3) must be a whole", id="cuts scenes"
        ),
        pytest.param('database = "mysql://a/b"', "a URL like postgresql://", id="no PostgreSQL"),
    ],
)
def test_what_cannot_be_meant_in_the_file_is_named(text: str, says: str) -> None:
    with pytest.raises(UsageError) as refused:
        load_settings(config=settings_file(text))
    assert says in str(refused.value)
    assert "fleet.toml" in str(refused.value)


def test_everything_that_is_wrong_is_said_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COUNTERPOINT_WORKRES", "2")
    monkeypatch.setenv("COUNTERPOINT_LEASE_S", "soon")
    with pytest.raises(UsageError) as refused:
        load_settings(config=settings_file("stat = 1"), max_attempts=0)
    for says in (
        "unknown setting stat; did you mean state?",
        "unknown variable COUNTERPOINT_WORKRES; did you mean COUNTERPOINT_WORKERS?",
        "COUNTERPOINT_LEASE_S=soon: must be a number above 1",
        "--max-attempts 0: must be a whole number from 1 to 1e+06",
    ):
        assert says in str(refused.value)


def test_an_impossible_flag_is_named_as_it_was_written() -> None:
    with pytest.raises(UsageError, match=r"^--shard-seconds 0: must be a number above 0"):
        load_settings(shard_seconds=0)


def test_a_file_that_is_not_there_is_named() -> None:
    with pytest.raises(UsageError, match=r"cannot read the settings file: .* \(nowhere.toml\)"):
        load_settings(config=Path("nowhere.toml"))


@pytest.mark.parametrize(
    "name",
    ["COUNTERPOINT_REFERENCE", "COUNTERPOINT_PORT_7447_TCP_ADDR", "COUNTERPOINT_API_SERVICE_HOST"],
)
def test_variables_of_others_are_passed_over(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, "whatever")
    assert load_settings() == Settings()


@pytest.mark.parametrize(
    "url",
    [
        f"postgresql://me:{SECRET}@127.0.0.1:9/x",
        f"postgres://me:a@{SECRET}@db/x",
        f"postgresql://me@db/x?password={SECRET}",
        f"mysql://me:{SECRET}@db/x",
        f"postgresql://me:a/{SECRET}@db/x",
    ],
)
def test_a_password_is_never_shown(url: str, capsys: pytest.CaptureFixture[str]) -> None:
    file = settings_file(f'database = "{url}"\n')
    file.chmod(0o600)
    for argv in (["config"], ["config", "--json"], ["top"], ["run", "--bucket", ".", "--dry-run"]):
        main([*argv, "--config", str(file)])
    told = capsys.readouterr()
    assert "me:***@" in told.out + told.err or "password=***" in told.err
    assert SECRET not in told.out + told.err


@pytest.mark.parametrize("end", ["\udce9", "\0"])
def test_a_value_that_is_no_text_is_refused_without_its_password(end: str) -> None:
    with pytest.raises(UsageError) as refused:
        read_settings(database=f"postgresql://app:{SECRET}{end}@host/db")
    assert "must be UTF-8 text without a NUL character" in str(refused.value)
    assert SECRET not in str(refused.value)


def test_a_password_that_others_can_read_is_refused() -> None:
    with pytest.raises(UsageError, match="in the list of processes"):
        load_settings(database=f"postgresql://me:{SECRET}@db/x")
    file = settings_file(f'database = "postgresql://me:{SECRET}@db/x"\n')
    file.chmod(0o644)
    with pytest.raises(UsageError, match=r"chmod o-r it") as refused:
        load_settings(config=file)
    assert SECRET not in str(refused.value)


def test_settings_that_are_printed_hide_the_password(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COUNTERPOINT_DATABASE", f"postgresql://me:{SECRET}@db/x")
    settings = load_settings()
    assert SECRET in settings.database
    assert SECRET not in repr(settings)


def test_any_spelling_of_postgres_is_understood() -> None:
    for scheme in ("postgres", "postgresql", "postgresql+psycopg"):
        url = load_settings(database=f"{scheme}://me@db/x").database
        assert url == "postgresql+psycopg://me@db/x"


def test_the_verb_config_lists_every_setting(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {row["setting"] for row in rows} >= {"bucket", "grid.shard_s", "database", "heartbeat_s"}
    assert {row["origin"] for row in rows} == {"default"}


def test_a_daemon_that_logs_json_says_its_errors_as_json(
    capsys: pytest.CaptureFixture[str],
) -> None:
    argv = ["service", "--bucket", "nowhere", "--state", "state"]
    assert main([*argv, "--log-format", "json"]) == 1
    events = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert events[-1]["level"] == "error"
    assert "does not exist" in events[-1]["event"]
    assert main(argv) == 1
    assert capsys.readouterr().err.startswith("error: ")


def test_what_can_be_made_again_is_kept_with_the_compiled_loops_never_in_tmp(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/var/cache/counterpoint")
    assert cache_folder() == Path("/var/cache/counterpoint")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "counterpoint"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/home/me")
    assert cache_folder() == Path("/home/me/.cache/counterpoint")
