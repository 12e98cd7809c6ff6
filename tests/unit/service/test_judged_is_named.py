"""Whoever reads a score is told whose labels it judges."""

from contextlib import closing
from pathlib import Path

import pytest

from schemas.score import SupervisedHealth
from service.cli.main import main
from service.cli.report import say_judged, say_open, say_what_was_found
from service.curation.status import Judged, Status
from service.store.engine import open_store
from tests.contracts.ledger_world import World
from tests.factories import scene_score


def state_of(folder: Path) -> Path:
    state = folder / "state"
    state.mkdir()
    with closing(open_store(state)) as store:
        world = World.on(store)
        world.listed("a")
        world.mine_all()
    return state


def test_top_names_the_streams_of_the_best_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state = state_of(tmp_path)
    assert main(["top", "--state", str(state)]) == 0
    said = capsys.readouterr()
    assert "streams of the best scene: supervised stream s@1, compared with r@1" in said.err
    assert main(["top", "--state", str(state), "--json"]) == 0
    assert capsys.readouterr().err == "", "machines read the record"


def test_an_empty_ranking_names_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "state").mkdir()
    with closing(open_store(tmp_path / "state")):
        pass
    assert main(["top", "--state", str(tmp_path / "state")]) == 0
    assert "streams of" not in capsys.readouterr().err


def test_a_summary_counts_scenes_where_streams_differ(capsys: pytest.CaptureFixture[str]) -> None:
    one = Judged(supervised="recorded@2", selfsupervised="r@1", scenes=3)
    say_what_was_found(Status(pipeline_version="p", judged=(one,)))
    assert "streams: supervised stream recorded@2, compared with r@1\n" in capsys.readouterr().err
    two = one.model_copy(update={"supervised": "s@1", "scenes": 2})
    say_what_was_found(Status(pipeline_version="p", judged=(one, two)))
    assert (
        "streams: supervised stream recorded@2, compared with r@1 in 3 scenes; supervised stream "
        "s@1, compared with r@1 in 2 scenes\n"
    ) in capsys.readouterr().err


def test_scores_name_their_streams_once(capsys: pytest.CaptureFixture[str]) -> None:
    score = scene_score()
    say_judged([score, score])
    made_by = score.producers
    assert capsys.readouterr().err == (
        f"streams: supervised stream {made_by.supervised}, compared with {made_by.selfsupervised}\n"
    )
    say_judged([])
    assert capsys.readouterr().err == ""


def test_what_the_model_leaves_open_is_summed_over_the_scenes(
    capsys: pytest.CaptureFixture[str],
) -> None:
    health = SupervisedHealth(labelled_share=0.5, unanswered_share=0.25, reason="no motion")
    complete = scene_score(points=300, frames=30)
    say_open([complete])
    assert capsys.readouterr().err == ""
    say_open([complete, scene_score(number=1, points=100, frames=10, supervised=health)])
    told = capsys.readouterr().err
    assert "no motion; 88% of the returns can contradict\n" in told
    assert "no answer in 6% of the frames" in told
