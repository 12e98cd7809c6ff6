from pathlib import Path
from typing import Any

import pytest

from schemas.attribution import Attribution, Wrong
from schemas.mining import MiningSettings
from schemas.work import Part, Recording
from service.reports.failure_report import write_report
from workers.lab.evaluation.failures.attribution import evaluate_attribution
from workers.lab.evaluation.failures.bench import FailureBench, with_slips
from workers.lab.evaluation.failures.common_mode import WITNESS_ALONE, common_mode
from workers.lab.evaluation.failures.false_alarms import (
    budget_threshold,
    by_disturbance,
    slip_false_alarms,
)
from workers.lab.evaluation.failures.mine_log import LogJob
from workers.lab.evaluation.failures.natural import natural_table
from workers.lab.evaluation.failures.planted import planted_table
from workers.lab.evaluation.failures.result_cache import load_mined_log, store_mined_log
from workers.lab.evaluation.failures.rows import MinedLog, ObjectRow, SceneRow, TrackRow
from workers.lab.evaluation.failures.uncertainty import Probing
from workers.lab.simulation.faults.plan import (
    DISTURBANCE_MEANS,
    FAILURE_MEANS,
    DisturbanceKind,
    FailureKind,
)

SCENES = 10


def thing(key: str = "track 1", **changes: Any) -> ObjectRow:
    fields: dict[str, Any] = {
        "key": key,
        "track": int(key.split()[1]) if key.startswith("track") else -1,
        "class_name": "car",
        "moves": True,
        "frames": 20,
        "points": 100,
        "fails": True,
        "kind": "unseen_class",
        "other_wrong_share": 0.0,
        "views": {"confidence": 0.1},
    }
    return ObjectRow(**(fields | changes))


def track(verdict: Wrong | None, said: Wrong | None = None, **changes: Any) -> TrackRow:
    told = None
    if said is not None:
        chances = {each.value: 0.7 if each is said else 0.1 for each in Wrong}
        told = Attribution.model_validate({"wrong": said, **chances})
    fields: dict[str, Any] = {
        "kind": "only_predictive_dynamic",
        "strength": 0.5,
        "presence": 0.9,
        "gate": 1.0,
        "evidence": {},
        "frames": 10,
        "points": 1000,
        "thing": "track 1",
        "true_track": 1,
        "verdict": verdict,
        "said": told,
    }
    return TrackRow(**(fields | changes))


def row(cell: int, score: float, *things: ObjectRow, **changes: Any) -> SceneRow:
    fields: dict[str, Any] = {
        "scene_id": f"log/lidar/{cell}",
        "start_ns": cell * 2_000_000_000,
        "cell": cell,
        "state": "scored",
        "score": score,
        "seconds": 2.0,
        "blind_share": 0.0,
        "views": {"point_share": 0.01 * (cell % 3)},
        "things": things,
        "tracks": (),
    }
    return SceneRow(**(fields | changes))


def log(number: int, *scenes: SceneRow, **changes: Any) -> MinedLog:
    fields: dict[str, Any] = {
        "log_id": f"car/day/{number}",
        "frames": 20 * len(scenes),
        "scenes": scenes,
        "pipeline_version": "0",
    }
    return MinedLog(**(fields | changes))


def fleet(logs: int = 6) -> list[MinedLog]:
    """One failing scene a log, which the score puts first."""
    return [
        log(
            number,
            *(
                row(cell, 0.9 - 0.01 * number, thing()) if cell == 4 else row(cell, 0.05 * cell)
                for cell in range(SCENES)
            ),
            planted=1,
        )
        for number in range(logs)
    ]


def test_a_score_that_puts_failures_first_gains_all_there_is() -> None:
    table = planted_table(fleet(), draws=50)
    assert (table.scenes, table.failures, table.failing_scenes) == (60, 6, 6)
    assert table.ap == 1.0
    assert table.precision_at["10"] == 1.0
    assert table.lift_at["10"] == 10.0
    assert table.gain == 1.0
    assert table.ap_interval == (1.0, 1.0)
    assert set(table.baselines) == {"random", "point_share"}
    assert table.baselines["random"].precision_at["5"] == 0.1
    assert table.kinds["unseen_class"].ap == 1.0
    assert table.attribution_accuracy is None
    assert table.common_mode_recall is None
    assert table.slips is None


def test_the_keys_that_others_read_are_at_the_top() -> None:
    bench = FailureBench(bucket="b", logs=6, planted=planted_table(fleet(), draws=0))
    out = bench.as_json()
    keys = {"scenes", "failures", "ap", "precision_at", "lift_at", "baselines"}
    assert keys | {"attribution_accuracy", "common_mode_recall", "natural"} <= set(out)
    assert {"scenes", "failures", "ap", "precision_at", "lift_at"} <= set(
        out["baselines"]["random"]
    )
    assert out["natural"] is None
    assert out["judged"] == {}


def test_a_thing_that_fails_in_two_scenes_is_one_failure_and_a_swap_is_one() -> None:
    twice = log(0, row(0, 0.5, thing()), row(1, 0.4, thing()))
    assert planted_table([twice], draws=0).failures == 1
    swap = [thing("track 1", kind="label_swap"), thing("track 2", kind="label_swap")]
    assert planted_table([log(0, row(0, 0.5, *swap), row(1, 0.1))], draws=0).failures == 1


def test_a_common_mode_failure_surfaces_by_the_witness_and_a_high_rank() -> None:
    shared = thing(common_mode=True, kind="missed_mover", other_wrong_share=0.9)
    witness = track(Wrong.BOTH, kind=WITNESS_ALONE)
    scenes = [
        row(0, 0.9, shared, tracks=(witness,)),
        row(1, 0.01, shared, tracks=(witness,)),
        row(2, 0.8, shared),
        row(3, 0.7, thing(common_mode=True, other_wrong_share=0.2), tracks=(witness,)),
        *(row(cell, 0.1) for cell in range(4, 24)),
    ]
    found = common_mode(scenes)
    assert (found.planted, found.both_wrong) == (4, 3)
    assert (found.witnessed, found.in_budget, found.surfaced) == (2, 2, 1)
    assert found.recall == pytest.approx(1 / 3, abs=1e-4)


def test_balanced_accuracy_is_the_mean_recall_of_what_occurs_ten_times() -> None:
    tracks = [track(Wrong.SUPERVISED, Wrong.SUPERVISED)] * 30
    tracks += [track(Wrong.SELFSUPERVISED, Wrong.SELFSUPERVISED)] * 5
    tracks += [track(Wrong.SELFSUPERVISED, Wrong.SUPERVISED)] * 5
    tracks += [track(Wrong.BOTH, Wrong.SUPERVISED)] * 9  # too few to count
    tracks += [track(None, Wrong.BOTH)] * 20  # truth does not say
    tracks += [track(Wrong.NEITHER, Wrong.BOTH, frames=2)] * 20  # too short
    found = evaluate_attribution(tracks)
    assert found.accuracy == pytest.approx(0.75)
    assert found.commonest == 0.5
    assert found.plain_accuracy == pytest.approx(35 / 49, abs=1e-4)
    assert found.cases == {"supervised": 30, "selfsupervised": 10, "both": 9, "neither": 0}
    assert found.confusion["selfsupervised"]["supervised"] == 5
    assert found.calibration.ece == pytest.approx(abs(35 / 49 - 0.7), abs=1e-4)


def test_what_no_record_says_has_no_accuracy() -> None:
    found = evaluate_attribution([track(Wrong.SUPERVISED)] * 20)
    assert found.accuracy is None
    assert found.cases["supervised"] == 20


def test_labels_that_lie_on_no_object_are_an_error_by_points_alone() -> None:
    alone = {"kind": "only_semantic_dynamic", "true_track": -1}
    bled = track(Wrong.SUPERVISED, Wrong.NEITHER, thing="", **alone)
    ghost = track(Wrong.SUPERVISED, Wrong.SUPERVISED, thing="phantom 0", **alone)
    moved = track(Wrong.SELFSUPERVISED, Wrong.SELFSUPERVISED, thing="", true_track=-1)
    tracks = [*[bled] * 30, *[ghost] * 10, *[moved] * 10]
    table = planted_table([log(0, row(0, 0.5, tracks=tuple(tracks)))], draws=0)
    assert table.attribution.cases["supervised"] == 40
    assert table.attribution.accuracy == pytest.approx((0.25 + 1.0) / 2)
    by_object = table.attribution_by_object
    assert by_object.cases == {"supervised": 10, "selfsupervised": 10, "both": 0, "neither": 30}
    assert by_object.accuracy == 1.0


def test_disturbed_scenes_are_held_against_the_undisturbed_budget() -> None:
    quiet = [row(cell, cell / 100) for cell in range(100)]
    assert budget_threshold(quiet) == pytest.approx(0.95)
    slips = [row(cell, 0.99, disturbance="odometry_slip") for cell in range(3)]
    slips += [row(cell, 0.2, disturbance="odometry_slip") for cell in range(7)]
    found = by_disturbance([*quiet, *slips, row(0, 1.0, thing(), disturbance="odometry_slip")])
    assert found["odometry_slip"].share == pytest.approx(0.3)
    assert found["none"].share == pytest.approx(0.04)
    again = slip_false_alarms(quiet, [row(0, 0.97), row(1, 0.5), row(2, 0.99, thing())])
    assert again is not None
    assert (again.scenes, again.above) == (2, 1)


def test_things_are_as_suspicious_as_the_strongest_track_on_them() -> None:
    blamed = track(Wrong.SUPERVISED, strength=0.6, thing="track 1")
    excused = track(Wrong.SELFSUPERVISED, strength=0.1, thing="track 2")
    right = thing("track 2", fails=False, kind="")
    table = natural_table(
        [log(0, row(0, 0.5, thing(), right, tracks=(blamed, excused)), row(1, 0.1))], draws=0
    )
    assert (table.things, table.failing_things, table.failures) == (2, 1, 1)
    assert table.ap == 1.0
    assert table.recall_at["10"] == 1.0
    assert table.classes["car, moving"].failing == 1
    assert set(table.baselines) == {"random", "confidence"}


def test_what_was_mined_is_read_again_unless_something_changed(tmp_path: Path) -> None:
    part = Part(key="car/day/0.mcap", size=1, etag="a")
    recording = Recording(log_id="car/day/0", parts=(part,))
    settings = MiningSettings(bucket="b", artifacts="memory://", supervised="recorded")
    job = LogJob(recording, tmp_path / "truth")
    mined = log(0, row(0, 0.5))
    assert load_mined_log(tmp_path, job, settings, Probing()) is None
    store_mined_log(tmp_path, job, settings, Probing(), mined)
    assert load_mined_log(tmp_path, job, settings, Probing()) == mined
    assert (
        load_mined_log(tmp_path, with_slips(job, mined, scene_s=2.0), settings, Probing()) is None
    )
    assert load_mined_log(tmp_path, job, settings, Probing(dropout_every=5)) is None
    (kept,) = tmp_path.glob("*.json")
    kept.write_text("{}")
    assert load_mined_log(tmp_path, job, settings, Probing()) is None


def test_every_scene_slips_once_and_within_itself() -> None:
    part = Part(key="car/day/0.mcap", size=1, etag="a")
    job = LogJob(Recording(log_id="car/day/0", parts=(part,)), Path("truth"))
    slips = with_slips(job, fleet()[0], scene_s=2.0).slips
    assert len(slips) == SCENES
    for cell, slip in enumerate(slips):
        assert cell * 2e9 <= slip.start_ns < slip.end_ns <= (cell + 1) * 2e9


def test_the_report_holds_its_tables_and_plots(tmp_path: Path) -> None:
    file = tmp_path / "out" / "report.html"
    slipping = log(6, row(0, 0.1, disturbance="odometry_slip"))
    bench = FailureBench(
        bucket="fleet/<logs>",
        logs=6,
        judged={"natural": "<own>"},
        planted=planted_table([*fleet(), slipping], draws=20),
        natural=natural_table(fleet(), draws=20),
    )
    write_report(file, bench)
    page = file.read_text()
    assert page.count("<svg") == 6
    assert "fleet/&lt;logs&gt;" in page
    assert "Evaluated in <i>natural</i>: the supervised stream &lt;own&gt;" in page
    assert "unseen_class" in page
    assert FAILURE_MEANS[FailureKind.UNSEEN_CLASS] in page
    assert DISTURBANCE_MEANS[DisturbanceKind.ODOMETRY_SLIP] in page
    assert "point_share" in page


def test_no_name_becomes_markup_of_the_report(tmp_path: Path) -> None:
    script = "<script>alert('x')</script>\x1b[2J\x9b"
    planted = planted_table(fleet(), draws=20)
    natural = natural_table(fleet(), draws=20)
    named = planted.model_copy(
        update={
            "best_baseline": script,
            "baselines": {script: next(iter(planted.baselines.values()))},
            "kinds": {script: next(iter(planted.kinds.values()))},
            "disturbances": {script: next(iter(planted.disturbances.values()), None)}
            if planted.disturbances
            else {},
        }
    )
    who = natural.attribution.model_copy(
        update={
            "cases": {script: 1},
            "recall": {script: 1.0},
            "confusion": {script: {script: 1}},
        }
    )
    bench = FailureBench(
        bucket=script,
        logs=6,
        judged={script: script},
        planted=named,
        natural=natural.model_copy(
            update={
                "attribution": who,
                "classes": {script: next(iter(natural.classes.values()))},
                "baselines": {script: next(iter(natural.baselines.values()))},
            }
        ),
    )
    write_report(tmp_path / "report.html", bench)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<script" not in page
    assert page.count("&lt;script&gt;") >= 8
    assert all(char.isprintable() or char == "\n" for char in page)
