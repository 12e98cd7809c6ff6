"""`bench selection`: orders of a mined fleet, recurring failures, modes, and synthetic rows."""

import json
from pathlib import Path

import pytest

from schemas.arrays import NS_PER_S
from schemas.attribution import Attribution, Wrong
from service.cli.main import main
from service.evaluation.mined_fleet import fleet_of, read_fleets, recurring, track_of
from service.evaluation.scenes_to_look_at import BY_SCORE, FEWEST, looks_rows
from service.evaluation.synthetic_rows import speed_rows
from workers.lab.evaluation.failures.rows import MinedLog, ObjectRow, SceneRow, TrackRow

BLAMED = Attribution(
    wrong=Wrong.SUPERVISED, supervised=0.9, selfsupervised=0.1, both=0.0, neither=0.0
)


def mined(log: int, scores: list[float], failing: list[int]) -> MinedLog:
    """A log with one track in each scene; some of the scenes show a planted failure each."""
    scenes = []
    for number, score in enumerate(scores):
        thing = ObjectRow(
            key=f"track {number}",
            track=number,
            class_name="car",
            moves=True,
            frames=20,
            points=100,
            fails=number in failing,
            kind="missed_mover" if number in failing else "",
            other_wrong_share=0.0,
        )
        track = TrackRow(
            kind="only_predictive_dynamic",
            strength=score,
            presence=score,
            gate=1.0,
            frames=10,
            points=500,
            thing=thing.key,
            true_track=number,
            verdict=Wrong.SUPERVISED,
            said=BLAMED,
            evidence={"distance": 0.1 + 0.05 * number, "speed": 0.5},
            first_frame=0,
            place_m=(50.0 * number, 0.0, 0.0),
            size_m=(1.0 + number, 1.8, 1.5),
        )
        scenes.append(
            SceneRow(
                scene_id=f"sim-0{log}/day/street/lidar/{number}",
                start_ns=(10 * log + 4 * number) * NS_PER_S,
                cell=number,
                state="scored",
                score=score,
                seconds=1.9,
                blind_share=0.0,
                views={},
                things=(thing,),
                tracks=(track,),
            )
        )
    return MinedLog(
        log_id=f"sim-0{log}/day/street", frames=100, scenes=tuple(scenes), pipeline_version="p"
    )


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    for log in range(4):
        made = mined(log, [0.9 - 0.01 * log, 0.5, 0.3, 0.1], failing=[0, 3])
        (tmp_path / f"{log}.json").write_text(made.model_dump_json())
    return tmp_path


def test_each_order_is_measured_until_the_failures_are_found(kept: Path) -> None:
    fleet = fleet_of(read_fleets([kept]))
    rows = {row.order: row for row in looks_rows(fleet, draws=50) if row.found == "failures"}
    assert rows[BY_SCORE].distinct == 8
    assert rows[BY_SCORE].looks == {"0.5": 4, "0.8": 15, "0.9": 16}
    assert rows[FEWEST].looks == {"0.5": 4, "0.8": 7, "0.9": 8}
    assert rows[FEWEST].fewer == 0.5
    assert rows[BY_SCORE].intervals["0.9"] is not None
    assert {"best-distinct", "determinantal", "k-centre", "one-pass"} < set(rows)


def test_a_failure_that_recurs_is_found_once(kept: Path) -> None:
    fleet = fleet_of(recurring(read_fleets([kept]), times=3))
    assert len(fleet) == 48
    rows = {row.order: row for row in looks_rows(fleet, draws=0) if row.found == "failures"}
    assert rows[BY_SCORE].distinct == 8
    assert rows[FEWEST].looks["0.9"] == 8
    assert rows[BY_SCORE].intervals["0.9"] is None


def test_vehicles_of_two_fleets_are_told_apart(kept: Path) -> None:
    fleet = fleet_of(read_fleets([kept, kept]))
    assert len({each.candidate.scene.scene_id for each in fleet}) == 32
    assert len({each.candidate.vehicle for each in fleet}) == 8


def test_a_track_has_class_bearing_and_speed_of_its_row_and_rows_without_are_read() -> None:
    scene = mined(0, [0.9], failing=[0]).scenes[0]
    known = {"class_name": "bus", "strongest_m": (3.0, 4.0, 0.5), "speed_m_per_s": 7.0}
    record = track_of(scene.tracks[0].model_copy(update=known), scene, 0)
    assert (record.class_name, record.speed_m_per_s) == ("bus", 7.0)
    assert record.strongest.centre_m == (3.0, 4.0, 0.5)
    assert record.strongest.range_m == 5.0
    without = track_of(scene.tracks[0], scene, 0)
    assert (without.class_name, without.speed_m_per_s) == ("", 5.0)
    assert without.strongest.centre_m == (8.0, 0.0, 0.0)


def test_the_command_prints_rows(kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "selection", str(kept), "--draws", "0", "--rows", "0", "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert rows[-1]["tracks"] == 16
    assert {row["times"] for row in rows[:-1]} == {1}


def test_nothing_to_measure_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "selection", "--rows", "0"]) == 1
    assert "nothing to measure" in capsys.readouterr().err
    assert main(["bench", "selection", str(tmp_path)]) == 1
    assert "no mined logs in" in capsys.readouterr().err


def test_synthetic_rows_are_selected_from_in_time() -> None:
    rows = speed_rows(20_000)
    assert len(rows) == 8
    assert all(row.seconds < 5 for row in rows)
    assert all(row.missed == 0 for row in rows if row.scores == "few high" and row.budget == 50)
