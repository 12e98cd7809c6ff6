"""Verbs on verdicts, filters of `top`, and clients and services of earlier versions."""

import json
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from schemas.errors import PermanentError
from schemas.mining import MiningSettings
from schemas.transport.wire import encode
from service.api.control import Control
from service.api.messages import SelectionRequest, TopReply, TopRequest
from service.api.request_queue import MalformedError
from service.api.staging import Staging
from service.cli.main import main
from service.client.client import ControlClient
from service.curation import learned
from service.curation.rates import RatesRequest
from service.errors import UsageError
from service.store.engine import open_store
from service.store.state import StateLock
from tests.contracts.ledger_world import World


@pytest.fixture
def state(tmp_path: Path) -> list[str]:
    with closing(open_store(tmp_path)) as store:
        world = World.on(store)
        world.listed("a", "b")
        world.mine_all()
    return ["--state", str(tmp_path)]


def lines(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, Any]]:
    assert main([*arguments, "--json"]) == 0
    return lines(capsys)


def test_a_scene_is_judged_listed_and_undone(
    state: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    judged = ["--reviewer", "ann", *state]
    (stored,) = run(capsys, "verdict", "add", "1", "supervised", "--cause", "ground", *judged)
    assert (stored["ordinal"], stored["cause"], stored["record"]) == (1, "ground", "current")
    run(capsys, "verdict", "add", stored["scene_id"], "both", "--track", "1", *judged)
    assert [each["verdict"] for each in run(capsys, "verdict", "list", *state)] == [
        "both",
        "supervised",
    ]
    (best, *others) = run(capsys, "top", *state)
    assert (best["verdicts"]["supervised"], best["verdicts"]["tracks"]) == (1, 1)
    assert not any("verdicts" in row for row in others)
    run(capsys, "verdict", "undo", *judged)
    run(capsys, "verdict", "undo", "1", *judged)
    assert run(capsys, "verdict", "list", *state) == []
    assert len(run(capsys, "verdict", "list", "--all", *state)) == 4
    assert main(["verdict", "undo", *judged]) == 1
    assert "'ann' has no verdict to undo" in capsys.readouterr().err


def test_the_same_key_is_stored_once(state: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    once = ["verdict", "add", "1", "both", "--reviewer", "ann", "--key", "k", *state]
    assert run(capsys, *once) == run(capsys, *once)
    assert main([*once[:3], "neither", *once[4:]]) == 1
    assert "names another write" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["1", "wrong"], "no verdict 'wrong'; one of: supervised"),
        (["1", "both", "--cause", "x"], "no cause 'x': choose of unseen_class"),
        (["1", "both", "--track", "7"], "has no track 7"),
        (["a/lidar/7", "both"], "never a scene 'a/lidar/7'"),
        (["99", "both"], "no scene of rank 99"),
        (["1", "both", "--reviewer", "\x1b"], "--reviewer must have 1 to 256"),
        (["1", "both", "--key", ""], ""),
    ],
)
def test_what_cannot_be_judged_is_refused(
    state: list[str],
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    problem: str,
) -> None:
    accepted = main(["verdict", "add", *arguments, *state]) == 0
    assert accepted is (not problem)
    assert problem in capsys.readouterr().err


def test_own_causes_are_a_setting(
    state: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COUNTERPOINT_CAUSES", "wet lens,dirt")
    (stored,) = run(capsys, "verdict", "add", "1", "both", "--cause", "wet lens", *state)
    assert stored["cause"] == "wet lens"


def test_next_to_a_running_service_a_verdict_is_refused(
    state: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with StateLock(Path(state[1]), endpoint="tcp/127.0.0.1:9"):
        assert main(["verdict", "add", "1", "both", *state]) == 1
    assert "alone may judge: use --connect tcp/127.0.0.1:9" in capsys.readouterr().err


def test_agreement_is_printed(state: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["agreement", *state]) == 0
    assert "no scene is judged" in capsys.readouterr().err
    for reviewer, verdict in (("ann", "supervised"), ("bob", "neither")):
        assert main(["verdict", "add", "1", verdict, "--reviewer", reviewer, *state]) == 0
    capsys.readouterr()
    assert main(["agreement", *state]) == 0
    printed = capsys.readouterr()
    assert "1 conflict" in printed.out
    assert "ann: supervised, bob: neither" in printed.out
    assert "wrong on 1 of 1 judged scene, 100% (95 %: 21% to 100%)" in printed.err


def test_top_filters_through_the_listing(
    state: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    every = run(capsys, "top", *state)
    of_a = run(capsys, "top", "--log", "a", "--sort", "score", *state)
    assert [row["scene_id"] for row in of_a] == [
        row["scene_id"] for row in every if row["log_id"] == "a"
    ]
    every_filter = ["--kind", "only_predictive_dynamic", "--class", "car", "--mode", "s"]
    assert len(run(capsys, "top", *every_filter, "--since", "2020-01-01", *state)) == 16
    assert len(run(capsys, "top", "-n", "2", "--judged", "no", *state)) == 2
    assert run(capsys, "top", "--judged", "yes", *state) == []
    assert run(capsys, "top", "--within", "30", *state) == run(
        capsys, "top", "--beyond", "0", *state
    )
    assert main(["top", "--judged", "perhaps", *state]) == 1
    assert "judged: Input should be" in capsys.readouterr().err
    assert main(["top", "-n", "1", "--text", "PEDESTRIAN", *state]) == 0
    assert "1 of 18 scenes" in capsys.readouterr().out


def test_rates_and_selections_have_the_verdicts(
    state: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    run(capsys, "verdict", "add", "1", "supervised", *state)
    for by in ("vehicle", "version", "hour", "log"):
        rows = run(capsys, "rates", "--by", by, *state)
        assert sum(row["judged_scenes"] for row in rows) == 1
        assert sum(row["right_scenes"] for row in rows) == 1
    rows = run(capsys, "rates", "--since", "2030-01-01", *state)
    assert rows == []
    run(capsys, "select", "--budget", "3", "--name", "w", *state)
    rows = run(capsys, "selection", "show", "w", *state)
    assert [row["verdicts"]["supervised"] for row in rows if "verdicts" in row] == [1]


def control_of(folder: Path) -> Control:
    return Control(
        settings=MiningSettings(bucket="memory://", artifacts="memory://"),
        ledger=World.on(open_store(folder)).ledger,
        staging=Staging(),
        on_scenes=lambda: None,
        on_selection=lambda _: None,
    )


def test_an_earlier_client_gets_rows_that_it_knows(
    state: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    run(capsys, "verdict", "add", "1", "both", *state)
    run(capsys, "select", "--budget", "3", "--name", "w", *state)
    control = control_of(Path(state[1]))
    asked = {
        "top": TopRequest(),
        "selection": SelectionRequest(name="w"),
        "rates": RatesRequest(by="log"),
    }
    assert b"learned" not in encode(TopRequest()) + control.answer("top", encode(TopRequest()))
    for verb, request in asked.items():
        old, new = encode(request), encode(request.model_copy(update={"verdicts": True}))
        assert b"verdicts" not in old
        added = b"judged_scenes" if verb == "rates" else b'"verdicts"'
        assert added not in control.answer(verb, old)
        assert added in control.answer(verb, new)


def test_an_earlier_service_is_asked_again_without_verdicts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[bytes] = []

    def answer(_: ControlClient, verb: str, request: Any = None) -> bytes:
        asked.append(encode(request))
        if b"verdicts" in asked[-1]:
            raise PermanentError("malformed top: verdicts: Extra inputs are not permitted")
        return encode(TopReply(scenes=()))

    monkeypatch.setattr(ControlClient, "_ask", answer)
    assert ControlClient(["tcp/127.0.0.1:9"], root="r").top(3) == []
    assert asked == [b'{"most":3,"verdicts":true}', b'{"most":3}']


def test_the_refusal_of_an_unknown_field_names_it(state: list[str]) -> None:
    control = control_of(Path(state[1]))
    with pytest.raises(MalformedError, match="unknown: Extra inputs are not permitted"):
        control.answer("top", b'{"unknown":true}')


def test_the_verbs_answer_over_the_bus_what_the_state_answers(state: list[str]) -> None:
    control = control_of(Path(state[1]))
    assert json.loads(control.answer("scenes", b'{"most":2}'))["total"] == 18
    assert json.loads(control.answer("choices", b""))["vehicles"] == ["bus-7"]
    assert json.loads(control.answer("activity", b"{}"))["recorded"][0]["scenes"] == 18
    assert json.loads(control.answer("agreement", b"{}"))["scenes"] == 0
    assert json.loads(control.answer("verdicts", b"{}")) == {"next": None, "rows": []}


def test_a_learned_ranking_is_refused_without_enough_verdicts(
    state: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    run(capsys, "verdict", "add", "1", "both", *state)
    assert main(["top", "--learned", *state]) == 1
    assert "1 scenes have a verdict that decides, and 30 are needed" in capsys.readouterr().err
    with pytest.raises(UsageError, match="30 are needed"):
        control_of(Path(state[1])).answer("top", b'{"learned":true}')
    assert main(["top", "--learned", "--vehicle", "bus-7", *state]) == 1
    assert "leave out the filters" in capsys.readouterr().err


def test_a_learned_ranking_says_its_source_and_effect(
    state: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learned, "MIN_VERDICTS", 6)
    for rank in range(1, 7):
        verdict = "supervised" if rank % 2 else "neither"
        run(capsys, "verdict", "add", str(rank), verdict, *state)
    found, *rows = run(capsys, "top", "--learned", "-n", "4", *state)
    assert found["effect"]["verdicts"] == 6
    assert (found["effect"]["right"], found["effect"]["is_used"]) == (3, False)
    assert [row["rank"] for row in rows] == [1, 2, 3, 4]
    assert [row.keys() >= {"learned", "verdicts"} for row in rows] == [True] * 4
    answered = json.loads(control_of(Path(state[1])).answer("top", b'{"learned":true,"most":4}'))
    assert answered["learned"]["effect"] == found["effect"]
    assert main(["top", "--learned", *state]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "learned from 6 judged scenes of" in said
    assert "no gain on verdicts that were not seen: ranked by the score" in said
    assert "average precision" in said


def test_an_earlier_service_that_cannot_learn_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def answer(_: ControlClient, verb: str, request: Any = None) -> bytes:
        raise PermanentError("malformed top: learned: Extra inputs are not permitted")

    monkeypatch.setattr(ControlClient, "_ask", answer)
    with pytest.raises(PermanentError, match="earlier version, which does not learn"):
        ControlClient(["tcp/127.0.0.1:9"], root="r").top_learned(3)
