from dataclasses import replace
from pathlib import Path

import pytest

from schemas.attribution import Attribution, Wrong
from schemas.score import Reason, SceneScore
from service.cli.demo import say_chosen, say_demo_ranking
from service.cli.output import results
from service.curation.ranking import RankedScene
from service.demo.planted import DemoScene, with_truth
from service.demo.retrieval import found_in
from tests.demo_truth import one_thing, write_truth
from tests.factories import BEGIN_NS, LOG_ID, scene_score, track_record
from workers.lab.simulation.faults.fault_truth import (
    FILE,
    DisturbanceRow,
    FailureRow,
    PlantedTruth,
)
from workers.lab.simulation.faults.plan import DisturbanceKind, FailureKind

STREET = LOG_ID.rpartition("/")[2]
ERRS = Attribution(
    wrong=Wrong.SUPERVISED, supervised=0.9, selfsupervised=0.1, both=0.0, neither=0.0
)


def _ns(at_s: float) -> int:
    return BEGIN_NS + round(at_s * 1e9)


def _failure(kind: FailureKind, begin_s: float, end_s: float) -> FailureRow:
    return FailureRow(
        kind=kind,
        track=4,
        class_name="car",
        scene=0,
        start_s=begin_s,
        end_s=end_s,
        start_ns=_ns(begin_s),
        end_ns=_ns(end_s),
        common_mode=False,
        because="",
        other_track=-1,
        place_m=None,
        range_m=0.0,
    )


def _disturbance(begin_s: float, end_s: float) -> DisturbanceRow:
    return DisturbanceRow(
        kind=DisturbanceKind.ODOMETRY_SLIP,
        scene=0,
        start_s=begin_s,
        end_s=end_s,
        start_ns=_ns(begin_s),
        end_ns=_ns(end_s),
        strength=0.1,
        shift_m=0.0,
    )


@pytest.fixture
def scenes(tmp_path: Path) -> list[DemoScene]:
    """Four scenes of 2 s: a failure and a slip, a slip, nothing, and a failure that scores 0."""
    planted = PlantedTruth(
        failures=(
            _failure(FailureKind.GHOST_MOVER, 0.5, 1.5),
            _failure(FailureKind.FLICKER, 0.7, 2.0),
            _failure(FailureKind.MISSED_MOVER, 6.5, 7.5),
        ),
        disturbances=(_disturbance(1.0, 2.5),),
    )
    (tmp_path / LOG_ID).mkdir(parents=True)
    (tmp_path / LOG_ID / FILE).write_text(planted.model_dump_json())
    write_truth(tmp_path / LOG_ID, stamps_ns=[_ns(1.0)])
    told = (track_record(attribution=ERRS),)
    records = [
        scene_score(number=number, score=score, tracks=told if number < 3 else ())
        for number, score in enumerate((0.8, 0.3, 0.1, 0.0))
    ]
    ranking = [_row(rank, record) for rank, record in enumerate(records, start=1)]
    by_id = {record.scene_id: record for record in records}
    return with_truth(ranking, by_id, tmp_path, overlay_of=one_thing)


def _row(rank: int, record: SceneScore) -> RankedScene:
    return RankedScene(
        rank=rank,
        scene_id=record.scene_id,
        log_id=record.log_id,
        start_ns=record.start_ns,
        end_ns=record.end_ns,
        score=record.score,
        sha256="0" * 64,
    )


def test_what_was_planted_stands_beside_the_scene_that_it_is_in(scenes: list[DemoScene]) -> None:
    assert [scene.planted for scene in scenes] == [
        "ghost mover, flicker; disturbed: odometry slip",
        "disturbed: odometry slip",
        "-",
        "missed mover",
    ]


@pytest.fixture
def _wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing breaks, whatever COLUMNS says where the tests run."""
    monkeypatch.setattr(results, "width", 200)


@pytest.mark.usefixtures("_wide")
def test_whether_the_first_reason_names_what_was_planted_is_marked(
    scenes: list[DemoScene], capsys: pytest.CaptureFixture[str]
) -> None:
    assert [scene.named for scene in scenes] == [True, None, None, False]
    say_demo_ranking(scenes)
    said = capsys.readouterr().out
    assert "reason names" in said
    assert (said.count("yes"), said.count("no ")) == (1, 1)


def test_a_picture_is_named_after_rank_street_and_second(scenes: list[DemoScene]) -> None:
    assert scenes[1].file_name == f"02-{STREET}-2s.png"


@pytest.mark.usefixtures("_wide")
def test_scenes_with_a_failure_are_listed_however_far_down(
    scenes: list[DemoScene], capsys: pytest.CaptureFixture[str]
) -> None:
    say_demo_ranking(scenes, most=1)
    said = capsys.readouterr().out
    assert f"{STREET} at 0 s" in said
    assert "missed mover" in said
    assert f"{STREET} at 2 s" not in said


def test_rankings_are_held_against_failures_not_against_disturbances(
    scenes: list[DemoScene],
) -> None:
    ours = found_in(scenes)[0]
    assert ours.ap == pytest.approx((1.0 + 2 / 4) / 2)


def test_the_headline_is_that_of_the_record_and_a_dash_without_a_reason(
    scenes: list[DemoScene], capsys: pytest.CaptureFixture[str]
) -> None:
    headline = "supervised labels car dynamic, but its shape stays in place, 16 m behind"
    reasons = (Reason(headline=headline, track_id=0), Reason(headline="odometry"))
    record = scenes[0].record.model_copy(update={"reasons": reasons})
    told = replace(scenes[0], record=record)
    assert told.headline == headline
    silent = replace(scenes[0], record=record.model_copy(update={"reasons": ()}))
    assert silent.headline == "-"
    say_demo_ranking([told])
    assert headline in capsys.readouterr().out


def test_scenes_with_a_failure_that_a_selection_leaves_are_named(
    scenes: list[DemoScene], capsys: pytest.CaptureFixture[str]
) -> None:
    say_chosen(scenes, {scenes[0].row.scene_id, scenes[1].row.scene_id})
    said = capsys.readouterr().err
    assert "takes 2 scenes: 1 of the 2 with a planted failure, and 1 of the others" in said
    assert f"not selected: {STREET} at 6 s, rank 4, missed mover: without a reason" in said
