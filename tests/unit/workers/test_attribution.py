import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from schemas.attribution import Attribution, Wrong
from schemas.contradiction import ContradictionKind, Scene, TrackRecord
from schemas.labels import FrameLabels, MotionLabel
from tests.labelled_worlds import CLASS_NAMES, Thing, labelled_scene, ranked_tracks, shard_of
from workers.contradiction.attribution import (
    chances,
    table_of,
    tables,
)
from workers.contradiction.instances import find_instances
from workers.contradiction.score import score_scene
from workers.contradiction.track_features import NAMES
from workers.lab.evaluation.failures.attribution import by_object
from workers.lab.evaluation.failures.rows import MinedLog, ObjectRow, SceneRow, TrackRow
from workers.lab.training.attribution import (
    MIN_VERDICTS,
    fit,
    fit_kind,
    main,
)
from workers.lab.training.attribution_prior import PRIOR
from workers.lab.training.attribution_scores import leave_one_log_out
from workers.lab.training.attribution_tables import digest_of

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
PARKED = Thing((12, -4, 0), DYNAMIC, STATIC)
MISSED_BY_SELF = Thing((-10, 4, 0), DYNAMIC, STATIC, velocity_m_per_s=(5, 0, 0), measured=False)
MISSED_BY_BOTH = Thing((-10, 4, 0), STATIC, STATIC, velocity_m_per_s=(3, 0, 0), measured=False)
KIND = ContradictionKind.ONLY_SEMANTIC_DYNAMIC.value


class _Version:
    version = "x@000000000000"


class _Streams:
    supervised = selfsupervised = _Version()
    own_model = ""


def _witnessed(scene: Scene, label: MotionLabel) -> Scene:
    """The same scene, the witness calling every point so."""
    frames = []
    for frame in scene.frames:
        n = len(frame.agreements)
        said = FrameLabels(np.full(n, label, np.uint8), np.full(n, 0.9, np.float16))
        frames.append(replace(frame, witness=said))
    return replace(scene, frames=tuple(frames))


def _tracks(scene: Scene) -> tuple[TrackRecord, ...]:
    instances = find_instances(scene, class_names=CLASS_NAMES)
    return score_scene(
        shard_of("fleet/car-1/drive"),
        scene,
        instances,
        ranked_tracks(scene, instances),
        parts=_Streams(),
        pipeline_version="x",
    ).tracks


def _attribution(scene: Scene) -> Attribution:
    (track,) = _tracks(scene)
    assert track.attribution is not None
    return track.attribution


def test_a_parked_car_labelled_dynamic_is_the_supervised_streams_error() -> None:
    said = _attribution(_witnessed(labelled_scene([PARKED]), STATIC))
    assert said.wrong is Wrong.SUPERVISED
    assert said.supervised > 0.8
    assert "witness label static" in said.supporting


def test_a_mover_labelled_static_by_the_self_supervised_stream_alone_is_its_error() -> None:
    scene = _witnessed(labelled_scene([MISSED_BY_SELF]), DYNAMIC)
    tracks = [t for t in _tracks(scene) if t.kind == ContradictionKind.ONLY_SEMANTIC_DYNAMIC]
    said = tracks[0].attribution
    assert said is not None
    assert said.wrong is Wrong.SELFSUPERVISED
    assert tracks[0].strength < 0.2, "a look is for the failures of the supervised stream"


def test_a_witness_only_mover_has_strength() -> None:
    (track,) = _tracks(_witnessed(labelled_scene([MISSED_BY_BOTH]), DYNAMIC))
    assert track.kind == ContradictionKind.ONLY_WITNESS_DYNAMIC
    assert track.attribution is not None
    assert track.attribution.both > max(0.3, track.attribution.supervised)
    assert track.strength > 0.3


@pytest.mark.parametrize(("begins", "is_open"), [(16, True), (4, False)])
def test_what_begins_to_be_called_moving_as_the_log_ends_may_set_off(
    begins: int, is_open: bool
) -> None:
    phantom = replace(PARKED, frames=frozenset(range(begins, 20)))
    scene = labelled_scene([phantom, replace(PARKED, semantic=STATIC, at_m=(12, 9, 0))], frames=26)
    ends, goes_on = (
        _tracks(_witnessed(replace(scene, frames=scene.frames[:20], after=after), STATIC))[0]
        for after in ((), scene.frames[20:])
    )
    said, later = ends.attribution, goes_on.attribution
    assert said is not None
    assert later is not None
    assert (later.supervised - said.supervised > 0.15) is is_open
    assert ("end of the log" in (*said.supporting, *said.opposing)) is is_open
    assert "end of the log" not in (*later.supporting, *later.opposing, *later.neutral)


def test_a_transit_is_a_miss_and_a_stop_is_less_probably_one() -> None:
    table = tables()[ContradictionKind.ONLY_WITNESS_DYNAMIC.value]
    whole = dict.fromkeys(
        ("witness_dynamic", "continuity", "supervised_confidence", "road_user_size", "arrived"), 1.0
    )
    strolls = {
        "displacement": 0.15,
        "isolation": 0.8,
        "denied_share": 0.8,
        "selfsupervised_confidence": 0.5,
    }
    sees = {**dict.fromkeys(NAMES, 0.0), **whole, **strolls}
    stops, goes_on = (chances(table, {**sees, "transits": each}) for each in (0.0, 1.0))
    assert stops[Wrong.NEITHER] > 0.5 > goes_on[Wrong.NEITHER]
    assert goes_on[Wrong.BOTH] > stops[Wrong.BOTH]


def test_a_jittering_witness_only_track_is_no_streams_error() -> None:
    stands = replace(MISSED_BY_BOTH, velocity_m_per_s=(0, 0, 0))
    (track,) = _tracks(_witnessed(labelled_scene([stands]), DYNAMIC))
    assert track.attribution is not None
    assert track.attribution.wrong is Wrong.NEITHER
    assert track.strength < 0.2


def test_without_a_witness_the_rest_still_decides() -> None:
    assert _attribution(labelled_scene([PARKED])).wrong is Wrong.SUPERVISED


def test_the_four_chances_add_up_to_one() -> None:
    said = _attribution(_witnessed(labelled_scene([PARKED]), STATIC))
    assert said.supervised + said.selfsupervised + said.both + said.neither == pytest.approx(
        1.0, abs=2e-3
    )


def test_every_feature_is_named_and_between_0_and_1() -> None:
    scene = _witnessed(labelled_scene([PARKED, MISSED_BY_SELF]), DYNAMIC)
    for ranked in ranked_tracks(scene, find_instances(scene, class_names=CLASS_NAMES)):
        named = ranked.features.named()
        assert tuple(named) == NAMES
        assert all(0.0 <= value <= 1.0 for value in named.values())


def test_the_rim_of_an_agreed_mover_differs_from_an_isolated_object() -> None:
    body = Thing((12, -4, 0), DYNAMIC, DYNAMIC, points=400)
    rim = Thing((12, -2.9, 0), DYNAMIC, STATIC, size_m=(4.0, 0.3, 1.5), points=60)
    (track,) = ranked_tracks(
        scene := labelled_scene([body, rim]), find_instances(scene, class_names=CLASS_NAMES)
    )
    assert track.features.agreed_share > 0.5
    assert track.features.denied_share < 0.3
    assert track.attribution is not None
    assert track.attribution.wrong is Wrong.NEITHER


def test_a_table_may_use_known_features_only() -> None:
    with pytest.raises(ValueError, match="uses features that do not exist: colour"):
        table_of({"supervised": {"intercept": 0.0, "weights": {"colour": 1.0}}})


def test_every_kind_of_motion_has_a_table_that_ships() -> None:
    assert set(tables()) == {kind.value for kind in ContradictionKind}


def _row(wrong: Wrong, **evidence: float) -> TrackRow:
    known = {**dict.fromkeys(NAMES, 0.0), "duration": 1.0, "point_count": 1.0, **evidence}
    return TrackRow(
        kind=KIND,
        strength=0.5,
        presence=1.0,
        gate=1.0,
        frames=10,
        points=500,
        thing="track 1",
        true_track=1,
        verdict=wrong,
        evidence=known,
    )


def _log(name: str, tracks: list[TrackRow]) -> MinedLog:
    """A log of one scene a track; a scene fails where the supervised stream is wrong."""
    scenes = []
    for cell, track in enumerate(tracks):
        fails = track.verdict is Wrong.SUPERVISED
        thing = ObjectRow(
            key="track 1",
            track=1,
            class_name="car",
            moves=True,
            frames=10,
            points=50,
            fails=fails,
            other_wrong_share=0.0,
        )
        scenes.append(
            SceneRow(
                scene_id=f"{name}/{cell}",
                start_ns=cell,
                cell=cell,
                state="scored",
                score=0.5,
                seconds=2.0,
                blind_share=0.0,
                views={},
                things=(thing,),
                tracks=(track,),
            )
        )
    return MinedLog(log_id=name, frames=20, scenes=tuple(scenes), pipeline_version="x")


def test_without_rows_the_table_is_the_prior() -> None:
    fitted = fit_kind(KIND, [])
    intercept, weights = PRIOR[KIND][Wrong.SUPERVISED]
    assert fitted["supervised"]["intercept"] == intercept
    assert fitted["supervised"]["weights"] == weights


def test_rows_draw_weights_to_what_they_show_in_logs_that_were_left_out_too() -> None:
    tracks = [
        _row(Wrong.SELFSUPERVISED if turning else Wrong.SUPERVISED, turn_rate=turning)
        for turning in (0.0, 1.0)
        for _ in range(20)
    ]
    logs = [_log(name, tracks) for name in ("a", "b", "c")]
    fitted = fit(logs)[KIND]
    assert fitted["selfsupervised"]["weights"]["turn_rate"] > 0.5
    known = chances(table_of(fitted), tracks[-1].evidence)
    assert known[Wrong.SELFSUPERVISED] > 0.7
    judged = leave_one_log_out(logs, fit)
    assert judged["all"]["recall"] == {"selfsupervised": 1.0, "supervised": 1.0}
    assert judged["scenes"] == {
        "scenes": 120,
        "failing": 60,
        "ap": 1.0,
        "precision_at": {"0.5": 1.0, "1": 1.0, "2": 1.0, "5": 1.0, "10": 1.0},
    }


def test_scenes_are_ranked_by_tables_that_never_saw_their_log() -> None:
    """What is true of one log alone does not help to rank it."""
    told = [_row(Wrong.SUPERVISED, distance=1.0), _row(Wrong.NEITHER, turn_rate=1.0)] * 20
    lied = [_row(Wrong.SUPERVISED, turn_rate=1.0), _row(Wrong.NEITHER, distance=1.0)] * 20
    judged = leave_one_log_out([_log("a", told), _log("b", lied)], fit)
    assert judged["scenes"]["ap"] == pytest.approx(0.5, abs=0.05)
    assert judged["all"]["balanced_accuracy"] < 0.5


@pytest.mark.parametrize(
    ("size_m", "strange"),
    [
        ((1.0, 0.3, 0.45), True),  # a dog
        ((3.0, 2.5, 5.2), True),  # a crane
        ((9.0, 2.4, 0.8), True),  # an empty low loader
        ((4.2, 1.8, 1.4), False),
        ((4.2, 0.3, 1.1), False),  # the side of a car
        ((0.5, 0.5, 1.6), False),
        ((11.0, 2.5, 3.0), False),
    ],
)
def test_a_mover_shaped_like_nothing_that_networks_know_is_said_to_be(
    size_m: tuple[float, float, float], strange: bool
) -> None:
    missed = Thing(
        (12.0, 4.0, 0.0),
        semantic=STATIC,
        predictive=DYNAMIC,
        size_m=size_m,
        points=150 + round(30 * float(np.prod(size_m))),  # dense enough to be one thing
        velocity_m_per_s=(2.0, 0.0, 0.0),
    )
    said = _attribution(_witnessed(labelled_scene([missed]), DYNAMIC))
    assert ("atypical size" in said.neutral) is strange


def test_a_strange_shape_that_the_supervised_stream_saw_move_is_not_told() -> None:
    seen = Thing((12.0, 4.0, 0.0), semantic=DYNAMIC, predictive=STATIC, size_m=(1.0, 0.3, 0.4))
    assert "atypical size" not in _attribution(labelled_scene([seen])).neutral


def test_a_fit_can_start_from_an_earlier_table_and_judges_the_shipped_one(tmp_path: Path) -> None:
    kept, out, again = tmp_path / "kept", tmp_path / "first.json", tmp_path / "second.json"
    kept.mkdir()
    turned = [_row(Wrong.SELFSUPERVISED, turn_rate=1.0), _row(Wrong.SUPERVISED)] * 20
    for name in ("a", "b"):
        (kept / f"{name}.json").write_text(_log(name, turned).model_dump_json())
    assert main([str(kept), "--data", "x", "--out", str(out)]) == 0
    assert main([str(kept), "--data", "x", "--update", str(out), "--out", str(again)]) == 0
    weights = [
        json.loads(file.read_text())["kinds"][KIND]["selfsupervised"]["weights"]["turn_rate"]
        for file in (out, again)
    ]
    assert 0.5 < weights[0] < weights[1]  # the second fit goes on where the first one ended
    card = json.loads(again.read_text())["card"]
    assert card["left_out"]["all"]["tracks"] == card["shipped_before"]["all"]["tracks"]
    assert 0.0 <= card["left_out"]["all"]["calibration_error"] <= 1.0
    assert card["started_from"] == digest_of(out)


def test_evidence_that_a_row_was_mined_without_keeps_the_weight_of_the_prior(
    tmp_path: Path,
) -> None:
    row = _row(Wrong.SELFSUPERVISED)
    old = row.model_copy(
        update={"evidence": {k: v for k, v in row.evidence.items() if k != "arrived"}}
    )
    logs = [_log(name, [old] * 5) for name in ("a", "b")]
    fitted = fit(logs)[KIND]
    assert fitted["selfsupervised"]["weights"]["arrived"] == 1.0
    assert leave_one_log_out(logs, fit)["all"]["tracks"] == {"selfsupervised": 10}


def test_a_kind_whose_second_verdict_is_rare_keeps_the_prior() -> None:
    common = [_row(Wrong.NEITHER, turn_rate=1.0)] * 60
    rare = [_row(Wrong.SUPERVISED)] * (MIN_VERDICTS - 1)
    assert fit_kind(KIND, [*common, *rare]) == fit_kind(KIND, [])
    assert fit_kind(KIND, [*common, *rare, rare[0]]) != fit_kind(KIND, [])


def test_bled_labels_on_no_object_are_fitted_as_nobodys_error() -> None:
    nowhere = {"thing": "", "true_track": -1}
    bled = _row(Wrong.SUPERVISED, agreed_share=1.0).model_copy(update=nowhere)
    ghost = _row(Wrong.SUPERVISED).model_copy(update={**nowhere, "thing": "phantom 0"})
    assert by_object(bled).verdict is Wrong.NEITHER
    assert by_object(ghost) == ghost
    assert by_object(bled.model_copy(update={"true_track": 3})).verdict is Wrong.SUPERVISED
    judged = leave_one_log_out([_log(name, [bled, ghost] * 30) for name in ("a", "b")], fit)
    assert judged["all"]["recall"] == {"supervised": 0.5}
    assert judged["all_with_borders_as_neither"]["balanced_accuracy"] == 1.0


def test_kinds_that_are_not_asked_for_keep_the_earlier_table(tmp_path: Path) -> None:
    kept, out = tmp_path / "kept", tmp_path / "out.json"
    kept.mkdir()
    turned = [_row(Wrong.SELFSUPERVISED, turn_rate=1.0), _row(Wrong.SUPERVISED)] * 20
    (kept / "a.json").write_text(_log("a", turned).model_dump_json())
    other = ContradictionKind.ONLY_PREDICTIVE_DYNAMIC.value
    assert main([str(kept), "--data", "x", "--kinds", other, "--out", str(out)]) == 0
    table = json.loads(out.read_text())
    assert table["kinds"][KIND] == fit_kind(KIND, [])
    assert table["card"]["kinds"] == [other]
    with pytest.raises(SystemExit):
        main([str(kept), "--data", "x", "--kinds", "none", "--out", str(out)])


def test_a_file_that_is_no_table_is_refused(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept/a.json").write_text(_log("a", [_row(Wrong.SUPERVISED)]).model_dump_json())
    wrong = tmp_path / "wrong.json"
    wrong.write_text("[]")
    arguments = ["--data", "x", "--update", str(wrong), "--out", str(tmp_path / "out.json")]
    assert main([str(tmp_path / "kept"), *arguments]) == 1
    assert not (tmp_path / "out.json").exists()
