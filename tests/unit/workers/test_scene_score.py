import math
import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from schemas.attribution import Attribution, Wrong
from schemas.contradiction import ContradictionKind, LabelledFrame, Scene, SceneState
from schemas.frame import OdometryState, RecordedFix
from schemas.labels import Blindness, FrameHealth, MotionLabel
from schemas.score import MAX_RECORD_BYTES, MAX_TRACKS, MIN_REPORTED_STRENGTH, SceneScore
from schemas.surroundings import EARTH
from schemas.transport.wire import decode, encode_scene_score
from tests.labelled_worlds import (
    CLASS_NAMES,
    START_NS,
    Thing,
    labelled_scene,
    ranked_tracks,
    shard_of,
)
from workers.contradiction.agreement import compare
from workers.contradiction.instances import find_instances
from workers.contradiction.reasons import bearing, reason_of
from workers.contradiction.score import combine, score_scene
from workers.contradiction.size_priors import box_plausibility, not_flat
from workers.contradiction.track_motion import motion_plausibility
from workers.contradiction.track_score import persistence

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
HEALTHY, DEGRADED, LOST = OdometryState.HEALTHY, OdometryState.DEGRADED, OdometryState.LOST
MISSED_CAR = Thing((-20, 3, 0), STATIC, DYNAMIC, velocity_m_per_s=(10, 0, 0))
PHANTOM = Thing((12, -4, 0), DYNAMIC, STATIC, class_id=2, size_m=(0.6, 0.6, 1.7), points=60)
STREET = [replace(MISSED_CAR, at_m=(-20.0, 4.0 + 6.0 * lane, 0.0)) for lane in range(5)]
WALL = Thing((0, 15, 1), STATIC, STATIC, size_m=(40, 0.2, 4), points=1500, class_id=0)


@dataclass(frozen=True)
class _Version:
    version: str


@dataclass(frozen=True)
class _Streams:
    supervised: _Version = _Version("net@0123456789ab")
    selfsupervised: _Version = _Version("registration@ba9876543210")
    own_model: str = ""


def _score(
    scene: Scene, log_id: str = "fleet/car-1/drive", names: tuple[str, ...] = CLASS_NAMES
) -> SceneScore:
    instances = find_instances(scene, class_names=names)
    return score_scene(
        shard_of(log_id),
        scene,
        instances,
        ranked_tracks(scene, instances),
        parts=_Streams(),
        pipeline_version="abcdef012345",
    )


def _headlines(record: SceneScore) -> list[str]:
    return [reason.headline for reason in record.reasons]


def _score_of(*things: Thing) -> float:
    return _score(labelled_scene(things)).score


def test_a_scene_without_contradictions_scores_zero_and_has_no_reason() -> None:
    moving = Thing((0, 0, 0), DYNAMIC, DYNAMIC, velocity_m_per_s=(5, 0, 0))
    record = _score(labelled_scene([WALL, moving]))
    assert (record.score, record.reasons, record.tracks) == (0.0, (), ())
    assert record.state is SceneState.SCORED
    assert record.all_points["both_dynamic"] == pytest.approx(120 / 1620, abs=1e-4)


def test_what_the_supervised_stream_leaves_open_is_in_the_record_and_else_nothing_is() -> None:
    scene = labelled_scene([WALL, MISSED_CAR])
    complete = _score(scene)
    assert complete.supervised is None
    assert b'"supervised":{' not in encode_scene_score(complete)
    silent = replace(scene.frames[0].semantic, health=FrameHealth(answered=False))
    plain = FrameHealth(reason="no motion is stated")
    frames = [
        replace(frame, semantic=replace(frame.semantic, health=plain)) for frame in scene.frames
    ]
    frames[0] = replace(frames[0], semantic=silent)
    record = _score(replace(scene, frames=tuple(frames)))
    assert record.supervised is not None
    assert record.supervised.labelled_share == 1.0
    assert record.supervised.unanswered_share == pytest.approx(1 / len(frames), abs=1e-4)
    assert "no motion is stated; 100% of the returns can contradict" in _headlines(record)
    assert any("gave no answer in" in each for each in _headlines(record))
    assert SceneScore.model_validate_json(encode_scene_score(record)) == record


def test_the_headline_of_a_missed_car_has_its_speed() -> None:
    record = _score(labelled_scene([WALL, MISSED_CAR]))
    (track,) = record.tracks
    assert track.kind == ContradictionKind.ONLY_PREDICTIVE_DYNAMIC
    assert (track.frames, track.points, track.speed_m_per_s) == (20, 2400, 10.0)
    assert (track.first_ns, track.last_ns) == (START_NS, START_NS + 1_900_000_000)
    assert record.score == track.strength > 0.7
    (reason,) = record.reasons
    assert re.fullmatch(
        r"supervised labels car static, but self-supervised measures 10\.0 m/s, 20 m behind, "
        r"for 2\.0 s: "
        r"supervised wrong, \d+ %",
        reason.headline,
    )
    assert reason.track_id == 0


def test_the_headline_of_a_phantom_pedestrian_has_its_place() -> None:
    record = _score(labelled_scene([WALL, PHANTOM]))
    (reason,) = record.reasons
    assert reason.headline.startswith(
        "supervised labels pedestrian dynamic, but its shape stays in place, 13 m ahead, "
        "for 2.0 s: supervised wrong, "
    )
    assert reason.evidence == "for: static shape"
    strongest = record.tracks[0].strongest
    assert strongest.range_m == pytest.approx(math.hypot(12, 4), abs=0.3)
    assert (strongest.semantic_confidence, strongest.predictive_confidence) == (0.9, 0.9)


def _chances(wrong: Wrong) -> Attribution:
    chances = {each.value: 0.7 if each is wrong else 0.1 for each in Wrong}
    return Attribution(wrong=wrong, **chances)


@pytest.mark.parametrize(
    ("thing", "wrong", "headline"),
    [
        (
            MISSED_CAR,
            Wrong.SELFSUPERVISED,
            "self-supervised labels car dynamic, but supervised labels it static",
        ),
        (
            MISSED_CAR,
            Wrong.NEITHER,
            "supervised labels car static, but self-supervised measures 10.0 m/s",
        ),
        (
            replace(PHANTOM, velocity_m_per_s=(3, 0, 0)),
            Wrong.SUPERVISED,
            "supervised labels pedestrian dynamic, but self-supervised labels it static",
        ),
        (
            PHANTOM,
            Wrong.SELFSUPERVISED,
            "self-supervised labels pedestrian static, but supervised labels it dynamic",
        ),
        (
            PHANTOM,
            Wrong.BOTH,
            "supervised labels pedestrian dynamic, but its shape stays in place",
        ),
    ],
)
def test_a_headline_states_labels_and_measurements_and_no_truth(
    thing: Thing, wrong: Wrong, headline: str
) -> None:
    scene = labelled_scene([WALL, thing])
    instances = find_instances(scene, class_names=CLASS_NAMES)
    (ranked,) = ranked_tracks(scene, instances)
    told = reason_of(
        scene, instances, replace(ranked, attribution=_chances(wrong)), track_id=0
    ).headline
    assert told.startswith(f"{headline}, ")
    who = {"selfsupervised": "self-supervised"}.get(wrong.value, wrong.value)
    assert told.endswith(f": {who} wrong, 70 %")


def test_the_headline_of_the_witness_names_it() -> None:
    scene = labelled_scene([WALL, PHANTOM])
    instances = find_instances(scene, class_names=CLASS_NAMES)
    (ranked,) = ranked_tracks(scene, instances)
    (kind,) = (each for each in scene.task.kinds if each.of_witness)
    track = replace(ranked.track, kind=kind)
    for wrong, who in ((Wrong.BOTH, "both"), (Wrong.NEITHER, "witness")):
        seen = replace(ranked, track=track, attribution=_chances(wrong))
        assert re.fullmatch(
            "supervised labels pedestrian static, but the witness labels it dynamic, 13 m ahead, "
            f"for 2.0 s: {who} wrong, 70 %",
            reason_of(scene, instances, seen, track_id=0).headline,
        )


def test_a_strong_track_has_its_places_in_odom_space() -> None:
    (track,) = _score(labelled_scene([WALL, MISSED_CAR], ego_m_per_s=5)).tracks
    assert track.first_odom_m == pytest.approx((-20, 3, 0), abs=0.2)
    assert track.last_odom_m == pytest.approx((-1, 3, 0), abs=0.2)
    brief = replace(MISSED_CAR, frames=frozenset({7}), points=25)
    (weak,) = _score(labelled_scene([WALL, brief])).tracks
    assert weak.strength < MIN_REPORTED_STRENGTH
    assert weak.first_odom_m is weak.last_odom_m is None


def test_supporting_and_opposing_evidence_are_separate() -> None:
    attribution = Attribution(
        wrong=Wrong.SUPERVISED,
        supervised=0.6,
        selfsupervised=0.4,
        both=0.0,
        neither=0.0,
        supporting=("witness label static", "static shape", "no displacement", "few points"),
        opposing=("long range", "low height"),
        neutral=("narrow box",),
    )
    scene = labelled_scene([PHANTOM])
    instances = find_instances(scene, class_names=CLASS_NAMES)
    (ranked,) = ranked_tracks(scene, instances)
    reason = reason_of(scene, instances, replace(ranked, attribution=attribution), track_id=0)
    assert reason.headline.endswith(": supervised wrong, 60 %")
    assert reason.evidence == (
        "for: witness label static, static shape, no displacement; against: long range"
    )
    assert reason.text == f"{reason.headline}; {reason.evidence}"
    own = reason_of(
        *(scene, instances, replace(ranked, attribution=attribution)), track_id=0, own_model="net-7"
    )
    assert own.headline == reason.headline.replace("supervised", "net-7")


def test_the_score_never_falls_when_a_contradiction_is_added_or_grows() -> None:
    few = replace(PHANTOM, points=15)
    brief = replace(PHANTOM, frames=frozenset(range(6)))
    full = _score_of(WALL, PHANTOM)
    for less in (few, brief):
        assert 0 < _score_of(WALL, less) < full
    assert full < _score_of(WALL, PHANTOM, MISSED_CAR) < 1


def test_a_flicker_of_one_frame_is_a_tenth_at_most() -> None:
    assert _score_of(WALL, replace(MISSED_CAR, frames=frozenset({7}))) < 0.1


def test_a_facade_that_seems_to_move_is_no_road_user() -> None:
    facade = replace(WALL, semantic=DYNAMIC, size_m=(32, 0.2, 4))
    assert _score_of(facade) == 0.0


def test_a_path_that_contradicts_the_measured_speed_weakens_a_track() -> None:
    stands = Thing((10, 3, 0), STATIC, DYNAMIC)
    times = np.arange(10) / 10
    still = np.tile((10.0, 3.0, 0.0), (10, 1))
    claims = np.tile((8.0, 0.0, 0.0), (10, 1))
    drives = still + times[:, None] * claims
    assert motion_plausibility(still, times, claims) == pytest.approx(0.1, abs=0.02)
    assert motion_plausibility(drives, times, claims) == pytest.approx(1.0)
    assert _score_of(WALL, stands) < _score_of(WALL, MISSED_CAR)


def test_a_hundred_small_contradictions_do_not_outweigh_one_clear_failure() -> None:
    specks = [
        Thing(
            (8.0 * (i % 10) - 40, 6.0 * (i // 10) - 30, 0),
            DYNAMIC,
            STATIC,
            points=14,
            size_m=(0.6, 0.6, 0.5),
            confidence=0.6,
            frames=frozenset(range(i % 13, i % 13 + 6)),
        )
        for i in range(100)
    ]
    noisy = _score(labelled_scene(specks))
    assert sum(total.tracks for total in noisy.totals) == 100
    assert 20 < len(noisy.tracks) <= MAX_TRACKS
    assert 0.02 < noisy.score < 0.5
    assert noisy.score < _score_of(MISSED_CAR)


@pytest.mark.parametrize(
    ("strengths", "expected"),
    [
        ((), 0.0),
        ((0.5,), 0.5),
        ((0.5, 0.5), 0.625),
        ((0.4, 0.8), 0.84),
        ((0.9999,) * 200, 0.9999),
    ],
)
def test_each_further_track_counts_half_of_the_one_before(
    strengths: tuple[float, ...], expected: float
) -> None:
    assert combine(strengths, decay=0.5) == expected


def test_a_scene_too_short_to_judge_scores_zero_and_says_so() -> None:
    record = _score(labelled_scene([MISSED_CAR], frames=4, too_short=True))
    assert (record.state, record.score) == (SceneState.TOO_SHORT, 0.0)
    assert _headlines(record) == ["too short to judge: 4 frames in 0.3 s"]
    assert record.totals[1].tracks == 1
    assert record.tracks[0].strength == 0.0


def test_a_scene_of_one_frame_is_scored_without_harm() -> None:
    record = _score(labelled_scene([MISSED_CAR], frames=1, too_short=True))
    assert (record.frames, record.score, record.odometry.distance_m) == (1, 0.0, 0.0)


def test_odometry_that_is_lost_gates_the_score_to_zero() -> None:
    record = _score(labelled_scene([MISSED_CAR], odometry=[LOST] * 11 + [HEALTHY] * 9))
    assert (record.state, record.score) == (SceneState.ODOMETRY_LOST, 0.0)
    assert record.odometry.state is LOST
    assert _headlines(record) == ["odometry lost (a bump): not judged"]


def test_odometry_that_is_degraded_for_a_moment_lowers_the_score() -> None:
    clean = _score(labelled_scene(STREET))
    bumpy = _score(labelled_scene(STREET, odometry=[DEGRADED] * 4 + [HEALTHY] * 16))
    assert bumpy.state is SceneState.SCORED
    strengths = [(a.strength, b.strength) for a, b in zip(bumpy.tracks, clean.tracks, strict=True)]
    assert all(0.8 * full < worth < 0.95 * full for worth, full in strengths)
    assert bumpy.score < clean.score
    assert _headlines(bumpy)[-1] == (
        "odometry degraded (a bump) in 20% of the frames, which have a lower weight"
    )
    assert bumpy.odometry.healthy_share == 0.8


def test_a_pose_doubted_outside_a_tracks_frames_does_not_lower_it() -> None:
    late = [replace(each, frames=frozenset(range(4, 20))) for each in STREET]
    clean = _score(labelled_scene(late))
    before = _score(labelled_scene(late, odometry=[DEGRADED] * 4 + [HEALTHY] * 16))
    amid = _score(labelled_scene(late, odometry=[HEALTHY] * 4 + [DEGRADED] * 4 + [HEALTHY] * 12))
    assert before.score == clean.score
    assert amid.tracks[0].strength < 0.85 * clean.tracks[0].strength
    assert amid.odometry.healthy_share == before.odometry.healthy_share


def test_a_doubted_pose_lowers_an_isolated_contradiction_less() -> None:
    doubted = [DEGRADED] * 20
    alone, amid = (_score(labelled_scene(each, odometry=doubted)) for each in (STREET[:1], STREET))
    assert alone.tracks[0].strength > 1.5 * amid.tracks[0].strength
    lost = _score(labelled_scene(STREET[:1], odometry=[LOST] * 6 + [HEALTHY] * 14))
    assert lost.tracks[0].strength < 0.6 * alone.tracks[0].strength


def test_shares_are_those_of_compared_points_with_and_without_the_ground() -> None:
    ground = Thing((0, 0, -2), STATIC, STATIC, size_m=(60, 60, 0.05), points=600, ground=True)
    unseen = Thing((0, 30, 0), UNKNOWN, STATIC, points=300)
    phantom = replace(PHANTOM, points=100)
    record = _score(labelled_scene([ground, unseen, phantom], frames=2))
    assert record.points == 2000
    assert record.compared_share == 0.7
    assert record.all_points["only_semantic_dynamic"] == pytest.approx(100 / 700, abs=1e-4)
    assert record.nonground_points["only_semantic_dynamic"] == 1.0


def test_where_nothing_was_compared_all_shares_are_zero() -> None:
    record = _score(labelled_scene([Thing((0, 9, 0), UNKNOWN, UNKNOWN)], frames=3))
    assert record.compared_share == 0.0
    assert set(record.all_points.model_dump().values()) == {0.0}


def test_the_same_scene_gives_the_same_bytes() -> None:
    things = [WALL, MISSED_CAR, PHANTOM]
    one, other = _score(labelled_scene(things)), _score(labelled_scene(things))
    assert encode_scene_score(one) == encode_scene_score(other)


@pytest.mark.parametrize(
    ("log_id", "tracks"),
    [
        pytest.param("fleet/car-1/" + "x" * 200, 20, id="a long name"),
        pytest.param("\u00e4" * 500, 10, id="five hundred umlauts, six bytes each, twice"),
    ],
)
def test_a_record_fits_the_bus_whatever_the_names(log_id: str, tracks: int) -> None:
    things = [
        Thing((9.0 * (i % 8) - 123.456, 9.0 * (i // 8) - 123.456, 0), STATIC, DYNAMIC, points=499)
        for i in range(48)
    ]
    frames = labelled_scene(things, frames=3).frames
    scene = Scene(f"{log_id}/lidar/{START_NS}", frames)
    names = tuple('"\\\u00e9' * 40 for _ in CLASS_NAMES)
    record = _score(scene, log_id, names)
    payload = encode_scene_score(record)
    assert len(payload) <= MAX_RECORD_BYTES
    assert decode(SceneScore, payload) == record
    assert record.totals[1].tracks == 48
    assert tracks <= len(record.tracks) <= MAX_TRACKS
    placed = []
    for number, frame in enumerate(frames):
        fix = RecordedFix(frame.stamp_ns, EARTH, (48.1, 11.5 + 1e-4 * number))
        cloud = replace(frame.posed.frame, fixes=(fix,))
        placed.append(replace(frame, posed=replace(frame.posed, frame=cloud)))
    there = _score(replace(scene, frames=tuple(placed)), log_id, names)
    assert there.place is not None
    assert there.tracks == record.tracks, "a place takes no track's room"
    assert len(encode_scene_score(there)) <= MAX_RECORD_BYTES


def test_factors_of_the_strength_rise_with_their_evidence() -> None:
    lasting = [
        persistence(frames=n, span_frames=n, period_s=0.1, scale_s=0.5) for n in range(1, 21)
    ]
    assert lasting == sorted(lasting)
    assert lasting[0] < 0.1
    assert lasting[-1] > 0.97
    assert box_plausibility(np.array([4.5, 1.8, 1.5])) == 1.0
    assert box_plausibility(np.array([4.5, 1.8, 0.1])) == 0.0
    assert 0 < box_plausibility(np.array([16.0, 2.5, 3.0])) < 1


@pytest.mark.parametrize(
    ("size_m", "range_m", "least", "most"),
    [
        ((4.5, 1.8, 1.5), 10.0, 1.0, 1.0),
        ((0.6, 0.5, 0.3), 10.0, 1.0, 1.0),
        ((16.0, 2.5, 3.0), 10.0, 1.0, 1.0),
        ((4.5, 0.2, 0.4), 60.0, 1.0, 1.0),
        ((2.7, 0.2, 0.03), 5.0, 0.0, 0.0),
        ((9.0, 0.2, 0.4), 20.0, 0.0, 0.05),
        ((4.8, 2.0, 0.7), 6.0, 0.3, 0.6),
    ],
    ids=["a car", "a cat", "a truck", "rows of a far car", "a strip", "a rail", "lifted road"],
)
def test_a_flat_box_is_no_road_user(
    size_m: tuple[float, float, float], range_m: float, least: float, most: float
) -> None:
    assert least <= not_flat(np.array(size_m), range_m) <= most


def test_a_flat_strip_labelled_dynamic_has_no_strength() -> None:
    car = replace(MISSED_CAR, at_m=(-10, 3, 0))
    strip = replace(car, size_m=(4.0, 0.4, 0.04))
    assert _score_of(WALL, strip) == 0.0 < 0.5 < _score_of(WALL, car)


def test_doubted_poses_do_not_lower_tracks_labelled_static() -> None:
    doubted = _score(labelled_scene([PHANTOM], odometry=[DEGRADED] * 20)).tracks[0]
    moving = _score(labelled_scene(STREET, odometry=[DEGRADED] * 20)).tracks[0]
    trusted = _score(labelled_scene([PHANTOM])).tracks[0]
    assert doubted.strength > 0.5 * trusted.strength
    assert moving.strength < 0.5 * _score(labelled_scene(STREET)).tracks[0].strength
    lost = [LOST] * 6 + [HEALTHY] * 14
    without = _score(labelled_scene([PHANTOM], odometry=lost)).tracks[0]
    assert without.strength < 0.6 * trusted.strength


@pytest.mark.parametrize(
    ("x_m", "y_m", "words"),
    [
        (10, 0, "ahead"),
        (10, 10, "ahead to the left"),
        (0, 3, "to the left"),
        (-5, 0.1, "behind"),
        (-5, -0.1, "behind"),
        (-3, -3, "behind to the right"),
        (0, -2, "to the right"),
        (4, -4, "ahead to the right"),
    ],
)
def test_directions_are_named_as_the_driver_sees_them(x_m: float, y_m: float, words: str) -> None:
    assert bearing(x_m, y_m) == words


def _missed(at_m: tuple[float, float, float], confirmed_share: float | None) -> Thing:
    return replace(MISSED_CAR, at_m=at_m, confirmed_share=confirmed_share)


def test_unconfirmed_motion_ranks_below_confirmed_motion() -> None:
    unproved, proved = _missed((-20, 3, 0), 0.0), _missed((-20, 12, 0), 1.0)
    record = _score(labelled_scene([WALL, unproved, proved]))
    first, second = record.tracks
    assert (first.confirmed_share, second.confirmed_share) == (1.0, 0.0)
    assert second.strength < 0.9 * first.strength


def test_a_larger_confirmed_share_makes_the_verdict_more_certain() -> None:
    untold = _score(labelled_scene([WALL, MISSED_CAR])).tracks[0]
    told = [
        _score(labelled_scene([WALL, _missed(MISSED_CAR.at_m, share)])).tracks[0].strength
        for share in (0.0, 0.25, 0.5, 1.0)
    ]
    assert told == sorted(told)
    assert told[0] < told[-1] == untold.strength


def test_a_stream_that_confirms_nothing_is_scored_as_before_and_its_record_is_silent() -> None:
    record = _score(labelled_scene([WALL, MISSED_CAR, PHANTOM]))
    assert [track.confirmed_share for track in record.tracks] == [None, None]
    assert b"confirmed" not in encode_scene_score(record)
    told = _score(labelled_scene([WALL, _missed(MISSED_CAR.at_m, 1.0), PHANTOM]))
    assert told.score == record.score
    by_kind = {track.kind: track.confirmed_share for track in told.tracks}
    assert by_kind[ContradictionKind.ONLY_SEMANTIC_DYNAMIC] is None
    assert encode_scene_score(told).count(b"confirmed_share") == 1


@pytest.mark.parametrize(
    ("semantic", "predictive", "says"),
    [
        (UNKNOWN, STATIC, "the supervised stream labelled no point"),
        (STATIC, UNKNOWN, "the self-supervised stream labelled no point"),
        (UNKNOWN, UNKNOWN, "the supervised and the self-supervised stream labelled no point"),
    ],
)
def test_a_scene_without_comparisons_names_the_stream_without_labels(
    semantic: MotionLabel, predictive: MotionLabel, says: str
) -> None:
    record = _score(labelled_scene([Thing((9, 0, 0), semantic, predictive)]))
    assert (record.score, record.compared_share) == (0.0, 0.0)
    assert _headlines(record) == [f"nothing was compared: {says}"]


def test_streams_that_never_labelled_the_same_point_are_reported() -> None:
    things = [Thing((9, 0, 0), UNKNOWN, STATIC), Thing((-9, 0, 0), STATIC, UNKNOWN)]
    record = _score(labelled_scene(things))
    assert _headlines(record) == ["nothing was compared: no point was labelled by both streams"]


def _blind(scene: Scene, *frames: int) -> Scene:
    """The same scene, the self-supervised stream blind in some of its frames."""
    health = FrameHealth(Blindness.NO_FIT, "half of the places are seen through")

    def seen(index: int, frame: LabelledFrame) -> LabelledFrame:
        if index not in frames:
            return frame
        labels = np.full(len(frame.agreements), UNKNOWN, np.uint8)
        predictive = replace(frame.predictive, labels=labels, confirmed=None, health=health)
        semantic = frame.semantic
        return replace(
            frame, predictive=predictive, agreements=compare(semantic.labels, predictive.labels)
        )

    return replace(scene, frames=tuple(seen(i, frame) for i, frame in enumerate(scene.frames)))


def test_a_scene_that_blindness_gated_says_so_last_and_why() -> None:
    scene = labelled_scene([WALL, MISSED_CAR])
    seen, partly = _score(scene), _score(_blind(scene, 0, 1, 2, 3, 4))
    assert not any("blind" in headline for headline in _headlines(seen))
    assert _headlines(partly)[-1] == (
        "self-supervised stream blind in 25% of the frames (half of the places are seen through)"
    )
    assert "but self-supervised measures 10.0 m/s" in partly.reasons[0].headline
    assert partly.score < seen.score


def test_a_scene_seen_by_one_stream_only_scores_zero_for_a_reason_that_it_tells() -> None:
    blind = _score(_blind(labelled_scene([WALL, MISSED_CAR]), *range(20)))
    assert (blind.state, blind.score, blind.tracks) == (SceneState.SCORED, 0.0, ())
    assert _headlines(blind) == [
        "self-supervised stream blind throughout (half of the places are seen through): nothing "
        "was compared"
    ]
    assert blind.health is not None
    assert blind.health.blind_share == 1.0
