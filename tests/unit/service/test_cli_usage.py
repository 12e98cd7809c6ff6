"""Bad arguments: one sentence on stderr, nothing on stdout, exit code 1; never a traceback."""

from pathlib import Path

import pytest

from service.cli.main import main
from workers.parts.catalogue import parts_of_kind
from workers.parts.part import PartSetting


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        pytest.param(["frobnicate"], "No such command", id="unknown verb"),
        pytest.param(["top", "-n", "many"], "Invalid value", id="not a number"),
        pytest.param(["select"], "Missing option", id="budget forgotten"),
        pytest.param(
            ["select", "--budget", "0"], "greater than or equal to 1", id="budget of nothing"
        ),
        pytest.param(["run", "--once"], "--bucket", id="no bucket named"),
        pytest.param(["inspect", "nowhere/at/all.mcap"], "no such file", id="no such file"),
        pytest.param(["top", "--connect", "here"], "tcp/host:port", id="not an endpoint"),
        pytest.param(
            ["eval", "motion", ".", "--truth", ".", "--frames", "9:3"], "no frame", id="9:3"
        ),
        pytest.param(
            ["run", "--once", "--bucket", "ftp://fleet"],
            "no bucket URL",
            id="unknown kind of bucket",
        ),
        pytest.param(
            ["run", "--once", "--bucket", ".", "--shard-seconds", "3"],
            "--shard-seconds 3: shard_s (3) must be a whole multiple",
            id="shards that cut scenes",
        ),
        pytest.param(
            ["service", "--bucket", ".", "--log-level", "loud"],
            "--log-level loud: must be debug or info",
            id="no such level",
        ),
        pytest.param(
            ["top", "--config", "nowhere.toml"], "cannot read the settings file", id="no such file"
        ),
        pytest.param(
            ["top", "--state", ".", "--connect", "tcp/127.0.0.1:7447"], "not both", id="two places"
        ),
        pytest.param(
            ["show", "1", "--out", "a.png", "--camera"], "No such option", id="a calibration"
        ),
        pytest.param(["run", "--bucket", ".", "--json"], "--log-format json", id="json of a run"),
        pytest.param(["run", "--bucket", ".", "--dry-run"], "no .mcap log", id="nothing to mine"),
        pytest.param(
            ["train", "pointnet", "--out", "w"], "none of the networks", id="no such network"
        ),
        pytest.param(
            ["train", "lmnet", "--out", "w", "--logs", "."], "belong together", id="truth forgotten"
        ),
        pytest.param(
            ["train", "lmnet", "--out", "w", "--streets", "0"], "nothing to learn", id="no data"
        ),
        pytest.param(
            ["train", "gndnet", "--out", "w", "--truth", "t"], "takes no --truth", id="no truth"
        ),
        pytest.param(
            ["train", "delora", "--out", "w", "--truth", "t"], "delora takes no", id="no truth here"
        ),
        pytest.param(
            ["train", "flowstep3d", "--out", "w", "--bfloat16"],
            "takes no --bf",
            id="full precision",
        ),
        pytest.param(
            ["train", "delora", "--out", "w", "--preset", "published-finetune"],
            "none of default, published",
            id="no such preset",
        ),
        pytest.param(
            ["train", "gndnet", "--out", "w", "--points", "128"], "of flowstep3d", id="no points"
        ),
        pytest.param(
            ["train", "salsanext", "--out", "w", "--classes", "mine"],
            "coarse",
            id="no such classes",
        ),
        pytest.param(
            ["adapt", ".", "--out", "w", "--device", "gpu"], "cpu or cuda", id="no device"
        ),
    ],
)
def test_a_usage_error_is_one_sentence_and_exit_code_one(
    argv: list[str],
    says: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(argv) == 1
    written = capsys.readouterr()
    assert written.out == ""
    assert says in written.err.replace("\n", " ")
    assert "Traceback" not in written.err


@pytest.mark.parametrize("verb", ["run", "service", "worker", "router"])
@pytest.mark.parametrize(
    ("text", "says"),
    [
        pytest.param("list_interval = 5", "bad.toml: unknown setting list_interval; did", id="key"),
        pytest.param("workers = -1", "bad.toml: workers = -1: must be a whole number", id="value"),
        pytest.param("", "unknown variable COUNTERPOINT_WORKRES; did you mean", id="variable"),
    ],
)
def test_no_daemon_starts_with_settings_that_cannot_be_meant(
    verb: str,
    text: str,
    says: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.toml").write_text(text)
    if not text:
        monkeypatch.setenv("COUNTERPOINT_WORKRES", "3")
    assert main([verb, "--config", "bad.toml"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert says in said
    assert said.count("\n") == 1, "one sentence"
    assert [path.name for path in tmp_path.iterdir()] == ["bad.toml"], "nothing was begun"


def test_workers_are_not_started_for_an_endpoint_that_is_none(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["worker", "--connect", "router:7447"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("error: not an endpoint: 'router:7447'; write it as tcp/host:port")
    assert said.count("\n") == 1, "one sentence"


def test_a_router_that_is_not_there_means_try_again(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["top", "--connect", "tcp/127.0.0.1:9"]) == 75
    assert "no router at tcp/127.0.0.1:9" in capsys.readouterr().err


def test_a_fault_of_the_program_is_not_taken_for_bad_input(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("nobody foresaw this")

    monkeypatch.setattr("service.cli.scenes.settings_for", broken)
    assert main(["status"]) == 70, "1 would tell systemd not to try again"
    said = capsys.readouterr().err
    assert "a fault of the program" in said
    assert "nobody foresaw this" in said


def test_a_state_that_is_not_there_is_named(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["top", "--state", str(tmp_path / "missing")]) == 1
    assert "missing" in capsys.readouterr().err.replace("\n", "")


def test_help_needs_no_bucket_and_lists_every_verb(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    told = capsys.readouterr().out
    verbs = ("run", "service", "worker", "router", "inspect", "score", "watch", "top", "select")
    for verb in (*verbs, "show", "status", "eval", "bench", "demo", "config", "doctor"):
        assert f"  {verb} " in told


@pytest.mark.parametrize("setting", ["odometry", "supervised", "selfsupervised"])
def test_help_lists_every_part_that_an_option_takes_with_a_line(
    setting: PartSetting, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["score", "--help"]) == 0
    told = [line.strip() for line in capsys.readouterr().out.splitlines()]
    said = " ".join(told)
    for part in parts_of_kind(setting):
        assert part.name in told, "alone in its line, to be copied"
        assert f"{part.name} {part.text}" in said
    assert max(map(len, told)) <= 80
