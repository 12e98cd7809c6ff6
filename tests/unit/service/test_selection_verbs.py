"""Verbs on selections: what is chosen, what is left out and why, and how it is found again."""

import json
from contextlib import closing
from pathlib import Path

import pytest

from service.cli.main import main
from service.store.engine import open_store
from tests.contracts.ledger_world import World
from tests.contracts.test_listing_contract import commit, scene
from tests.contracts.test_proposals_contract import two_days_in_a_street
from tests.factories import track_at
from tests.unit.service.mined_state import mined_state, scenes_at


@pytest.fixture
def state(tmp_path: Path) -> list[str]:
    """A state of several scenes, each with a reason; neighbours show the same car."""
    with closing(open_store(tmp_path)) as store:
        world = World.on(store)
        world.listed("a", "b")
        world.mine_all()
    return ["--state", str(tmp_path)]


def test_each_scene_that_is_left_out_has_a_line_with_its_cause(
    state: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["select", "--budget", "8", "--name", "week", *state]) == 0
    printed = capsys.readouterr()
    assert "selection 'week' by best-distinct: 8 of at most 8 scenes" in printed.out
    assert "pedestrian only semantic" in printed.out
    assert printed.err.count("left out: rank ") == 1
    assert "left out: rank 8, 0.420, b@" in printed.err
    assert ": twin of rank 7, which shows the same" in printed.err
    assert "the budget is used up at rank 9" in printed.err
    assert main(["select", "--budget", "50", "--name", "all", "--again", *state]) == 0
    printed = capsys.readouterr()
    assert "16 of at most 50 scenes" in printed.out, "twins fill the budget"
    assert printed.err.count("left out: rank ") == 2
    assert printed.err.count(": no reason, ") == 2


def test_scenes_are_selected_by_the_range_of_a_track(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes_at(tmp_path, 12.4, 45.0, 70.0)
    state = ["--state", str(tmp_path)]
    for dry_run in (["--dry-run"], []):
        asked = ["select", "--budget", "5", "--beyond", "40", "--within", "60", *dry_run, *state]
        assert main([*asked, "--json"]) == 0
        (row,) = map(json.loads, capsys.readouterr().out.splitlines())
        assert "45 m ahead" in str(row)
    for bounds, said in (
        (["--within", "nan"], "'--within': Input should be a valid integer"),
        (["--within", "0"], "--within"),
        (["--beyond", "-1"], "--beyond"),
        (["--beyond", "50", "--within", "30"], "greater than beyond, which is 50 m"),
    ):
        for verb in (["select", "--budget", "5"], ["top"]):
            assert main([*verb, *bounds, *state]) != 0
            printed = capsys.readouterr()
            assert printed.out == ""
            assert said in printed.err
            assert len(printed.err.splitlines()) == 1


def test_a_twin_in_place_is_named_and_rows_have_places(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with closing(open_store(tmp_path)) as store:
        commit(World.on(store), *two_days_in_a_street())
    state = ["--state", str(tmp_path)]
    assert main(["top", "--json", *state]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert rows[0]["place"]["latitude_deg"] == 48.137
    assert rows[1]["twin_of"] == rows[0]["scene_id"]
    assert main(["select", "--budget", "2", "--strategy", "k-centre", "--dry-run", *state]) == 0
    assert "first of place 48.1369 11.5746" in capsys.readouterr().out
    assert main(["select", "--budget", "2", *state]) == 0
    printed = capsys.readouterr()
    assert ": same place as rank 1, which shows the same" in printed.err
    assert main(["top", "--kind", "moving", *state]) == 0
    assert "no scene passes; `rates --by kind`" in capsys.readouterr().err


def test_a_class_is_found_in_any_case_and_known_ones_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tracks = (track_at(20.0, class_name="Car"), track_at(30.0, class_name="Bus"))
    with closing(open_store(tmp_path)) as store:
        commit(World.on(store), scene(0, 0.9, tracks=tracks))
    state = ["--state", str(tmp_path)]
    assert main(["top", "--class", "car", "--json", *state]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1
    for verb in (["top"], ["select", "--budget", "5"]):
        assert main([*verb, "--class", "tram", *state]) == 0
        assert "classes of strong tracks: Bus, Car\n" in capsys.readouterr().err
    assert main(["select", "--budget", "5", "--class", "car", *state]) == 0
    assert "1 of at most 5 scenes" in capsys.readouterr().out


def test_scenes_of_a_selection_that_were_withdrawn_are_named_with_the_cause(
    state: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["select", "--budget", "50", "--name", "all", "--again", *state]) == 0
    capsys.readouterr()
    assert main(["selection", "show", "all", "--json", *state]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    gone = [row["scene_id"] for row in rows if row.get("log_id") == "a"]
    assert len(gone) == 8
    assert main(["selection", "show", "all", *state]) == 0
    assert "no longer" not in capsys.readouterr().err, "all are current"
    with closing(open_store(tmp_path)) as store:
        World.on(store).listed("b")
    assert main(["selection", "show", "all", *state]) == 0
    said = capsys.readouterr().err
    assert said.count("is no longer listed: no current scene 'a/") == 5
    assert "3 more are no longer listed" in said
    assert main(["show", gone[0], "--out", str(tmp_path / "scene.png"), *state]) != 0
    said = capsys.readouterr().err
    assert f"no current scene {gone[0]!r}: it was withdrawn with event " in said
    assert "when its log was deleted from the bucket; it returns with the same log" in said
    with closing(open_store(tmp_path)) as store:
        World.on(store).listed("a", "b")
    assert main(["selection", "show", "all", *state]) == 0
    assert "no longer" not in capsys.readouterr().err


def test_scenes_without_a_reason_are_left_out_with_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mined_state(tmp_path, score=0.03, tracks=())
    assert main(["select", "--budget", "5", "--state", str(tmp_path)]) == 0
    printed = capsys.readouterr()
    assert "0 of at most 5 scenes" in printed.out
    assert ": no reason, no track is strong enough for a reason" in printed.err


def test_a_scene_that_is_left_out_has_the_causes_that_are_possible(
    state: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["select", "--budget", "1", "--name", "first", *state]) == 0
    capsys.readouterr()
    assert main(["select", "--budget", "1", "--name", "second", *state]) == 0
    assert ": selected earlier\n" in capsys.readouterr().err
    filtered = ["--again", "--since", "2100-01-01"]
    assert main(["select", "--budget", "1", "--name", "third", *filtered, *state]) == 0
    assert ": filtered\n" in capsys.readouterr().err


def test_a_stored_selection_is_listed_and_shown(
    state: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["select", "--budget", "2", "--name", "week", "--json", *state]) == 0
    stored = capsys.readouterr().out
    assert main(["selection", "list", "--json", *state]) == 0
    row = json.loads(capsys.readouterr().out)
    assert (row["name"], row["strategy"], row["scenes"]) == ("week", "best-distinct", 2)
    assert main(["selection", "show", "week", "--json", *state]) == 0
    assert capsys.readouterr().out == stored
    first = json.loads(stored.splitlines()[0])
    assert first["strategy"] == "best-distinct"
    assert first["tracks"][0]["class_name"] == "car"
    assert main(["selection", "list", *state]) == 0
    assert "week" in capsys.readouterr().out
    assert main(["selection", "show", "week", *state]) == 0
    assert "selection 'week' by best-distinct" in capsys.readouterr().out


def test_a_name_of_no_selection_is_refused(
    state: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["selection", "show", "friday", *state]) == 1
    assert "no selection 'friday'; `counterpoint selection list`" in capsys.readouterr().err
    assert main(["selection", "show", "a\nb", *state]) == 1
    assert "must have 1 to 256 printing characters" in capsys.readouterr().err


def test_a_dry_run_explains_each_choice_and_stores_nothing(
    state: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["select", "--budget", "3", "--strategy", "k-centre", "--dry-run", *state]
    assert main(asked) == 0
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert [line.split(".")[0] for line in lines] == ["1", "2", "3"]
    assert all(": adds 0." in line or ": adds 1." in line for line in lines)
    assert all("; score 0." in line for line in lines)
    assert "nothing is stored" in printed.err
    assert main(["selection", "list", "--json", *state]) == 0
    assert capsys.readouterr().out == ""


def test_a_strategy_or_filter_that_does_not_exist_is_refused_with_a_sentence(
    state: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["select", "--budget", "3", "--strategy", "nearest", *state]) == 1
    assert "no selection strategy 'nearest'; known: best-distinct" in capsys.readouterr().err
    assert main(["select", "--budget", "3", "--wrong", "nobody", *state]) == 1
    assert "wrong" in capsys.readouterr().err
    assert main(["select", "--budget", "3", "--since", "yesterdayish", *state]) == 1
    assert "since is no time" in capsys.readouterr().err


def test_modes_of_few_tracks_are_none(state: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["modes", *state]) == 0
    assert "modes are formed from 128 strong tracks on" in capsys.readouterr().err
