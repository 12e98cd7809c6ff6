"""Failures by truth, on hand-made scenes: things of forty points in twenty frames."""

from collections.abc import Mapping

import numpy as np
import pytest

from schemas.attribution import Wrong
from schemas.contradiction import Scene
from schemas.labels import MotionLabel
from tests.factories import labelled, scene
from tests.labelled_worlds import ranked_tracks
from workers.contradiction.instances import find_instances
from workers.lab.evaluation.failures.baseline_scores import flicker_share, scene_baselines
from workers.lab.evaluation.failures.frame_truth import FrameWithTruth
from workers.lab.evaluation.failures.object_views import object_baselines
from workers.lab.evaluation.failures.objects_of_interest import find_objects
from workers.lab.evaluation.failures.verdicts import object_under, verdict_of
from workers.lab.evaluation.truth.objects import TrueObject
from workers.lab.evaluation.truth.truth import FrameTruth

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
SIZE = 40
FRAMES = 20


def block(
    x_m: float, rng: np.random.Generator
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.array([x_m, 5.0, 1.0]) + rng.uniform(-0.4, 0.4, (SIZE, 3))


def world(
    *,
    truth: Mapping[int, int],
    semantic: Mapping[int, Mapping[int, int]],
    predictive: Mapping[int, Mapping[int, int]] | None = None,
    tracks: Mapping[int, int] | None = None,
) -> tuple[Scene, list[FrameWithTruth]]:
    """A scene of things in a row: thing -> true motion; thing -> frame -> what a stream says.

    What is not said is as the truth is. Things are their own tracks unless `tracks` says otherwise.
    """
    rng = np.random.default_rng(0)
    frames, seen = [], []
    right = {1: STATIC, 2: DYNAMIC, 0: STATIC}
    for number in range(FRAMES):
        places, true, said, other, ids = [], [], [], [], []
        for thing, motion in truth.items():
            places.append(block(6.0 * thing, rng))
            true.append(np.full(SIZE, motion))
            ids.append(np.full(SIZE, (tracks or {}).get(thing, thing)))
            said.append(np.full(SIZE, semantic.get(thing, {}).get(number, right[motion])))
            of_other = (predictive or {}).get(thing, {})
            other.append(np.full(SIZE, of_other.get(number, right[motion])))
        frame = labelled(
            np.concatenate(places), np.concatenate(said), np.concatenate(other), at_s=0.1 * number
        )
        frames.append(frame)
        objects = {thing: TrueObject(class_name="car") for thing in truth}
        seen.append(
            FrameWithTruth(
                frame,
                FrameTruth(
                    number,
                    np.concatenate(true).astype(np.uint8),
                    np.concatenate(ids).astype(np.int16),
                    objects,
                ),
            )
        )
    return scene(frames), seen


def during(first: int, end: int, label: MotionLabel) -> dict[int, int]:
    return dict.fromkeys(range(first, end), int(label))


def test_a_stream_that_is_right_fails_on_nothing() -> None:
    things = find_objects(*world(truth={1: 2, 2: 1}, semantic={}))
    assert [(thing.key, thing.moves, thing.fails) for thing in things] == [
        ("track 1", True, False),
        ("track 2", False, False),
    ]
    assert things[0].class_name == "car"


@pytest.mark.parametrize(("frames", "fails"), [(4, False), (5, True)])
def test_a_failure_lasts_half_a_second(frames: int, fails: bool) -> None:
    missed, standing = find_objects(
        *world(truth={1: 2, 2: 1}, semantic={1: during(6, 6 + frames, STATIC)})
    )
    assert missed.fails is fails
    assert missed.failing == tuple(range(6, 6 + frames))
    assert not standing.fails


def test_a_label_that_flickers_fails_by_the_sum_of_its_wrong_frames() -> None:
    flickers = {number: int(STATIC) for number in range(0, FRAMES, 3)}
    (thing,) = find_objects(*world(truth={1: 2}, semantic={1: flickers}))
    assert thing.fails
    assert len(thing.failing) == 7


def test_silence_is_no_error_and_neither_is_what_truth_does_not_know() -> None:
    (silent,) = find_objects(*world(truth={1: 2}, semantic={1: during(0, FRAMES, UNKNOWN)}))
    assert not silent.fails
    assert find_objects(*world(truth={1: 0}, semantic={1: during(0, FRAMES, DYNAMIC)})) == []


def test_a_phantom_where_nobody_is_is_a_thing_of_its_own() -> None:
    scene_, seen = world(
        truth={1: 2, 4: 1}, semantic={4: during(3, 15, DYNAMIC)}, tracks={1: 1, 4: -1}
    )
    mover, phantom = find_objects(scene_, seen)
    assert (mover.key, mover.fails) == ("track 1", False)
    assert (phantom.key, phantom.moves, phantom.fails) == ("phantom 0", False, True)
    assert len(phantom.points) == 12


def test_labels_that_bleed_onto_what_touches_a_mover_are_no_phantom() -> None:
    scene_, seen = world(truth={1: 2, 4: 1}, semantic={4: during(0, 20, DYNAMIC)}, tracks={4: -1})
    for frame in seen:  # the other block is brought against the mover
        points = frame.labelled.posed.frame.points_m
        points.flags.writeable = True
        points[SIZE:, 0] += 6.0 - 24.0 + 0.3
    assert [thing.key for thing in find_objects(scene_, seen)] == ["track 1"]


@pytest.mark.parametrize(
    ("truth", "semantic", "predictive", "verdict"),
    [
        (2, STATIC, DYNAMIC, Wrong.SUPERVISED),
        (1, DYNAMIC, STATIC, Wrong.SUPERVISED),
        (2, DYNAMIC, STATIC, Wrong.SELFSUPERVISED),
        (1, STATIC, DYNAMIC, Wrong.SELFSUPERVISED),
    ],
)
def test_truth_says_who_is_wrong_about_a_contradicting_track(
    truth: int, semantic: MotionLabel, predictive: MotionLabel, verdict: Wrong
) -> None:
    scene_, seen = world(
        truth={1: truth},
        semantic={1: during(0, FRAMES, semantic)},
        predictive={1: during(0, FRAMES, predictive)},
    )
    things = find_objects(scene_, seen)
    instances = find_instances(scene_, class_names=())
    (ranked,) = ranked_tracks(scene_, instances)
    members = [instances[member] for member in ranked.track.members]
    key, track = object_under(members, seen, things)
    assert (key, track) == ("track 1", 1)
    assert verdict_of(members, seen, track=track) is verdict


def test_a_contradiction_at_the_rim_of_what_both_know_blames_neither() -> None:
    scene_, seen = world(truth={1: 2}, semantic={})
    for frame in seen:  # a quarter of the mover
        for array in (frame.labelled.semantic.labels, frame.labelled.agreements):
            array.flags.writeable = True
        frame.labelled.semantic.labels[: SIZE // 4] = STATIC
        frame.labelled.agreements[: SIZE // 4] = 0b10
    instances = find_instances(scene_, class_names=())
    assert instances
    _, track = object_under(instances, seen, find_objects(scene_, seen))
    assert verdict_of(instances, seen, track=track) is Wrong.NEITHER


def test_where_truth_is_silent_nobody_is_blamed() -> None:
    scene_, seen = world(truth={1: 0}, semantic={1: during(0, FRAMES, DYNAMIC)})
    instances = find_instances(scene_, class_names=())
    assert instances
    assert verdict_of(instances, seen, track=1) is None


def test_flicker_is_what_changes_at_its_place() -> None:
    steady, _ = world(truth={1: 2, 2: 1}, semantic={1: during(0, FRAMES, STATIC)})
    assert flicker_share(steady.frames) == 0.0
    flickers = {number: int(STATIC) for number in range(0, FRAMES, 2)}
    flickering, _ = world(truth={1: 2, 2: 1}, semantic={1: flickers})
    assert flicker_share(flickering.frames) > 0.2


def test_other_ways_to_rank_see_what_they_look_at() -> None:
    quiet, _ = world(truth={1: 2, 2: 1}, semantic={})
    loud, seen = world(truth={1: 2, 2: 1}, semantic={1: during(0, 10, STATIC)})
    assert scene_baselines(quiet)["point_share"] == 0.0
    assert scene_baselines(loud)["point_share"] == pytest.approx(10 / FRAMES / 2)
    assert scene_baselines(loud)["confidence"] == 0.0
    failing, _ = find_objects(loud, seen)
    assert object_baselines(failing.points, seen)["point_share"] == pytest.approx(0.5)
    assert object_baselines(failing.points, seen)["flicker"] == pytest.approx(1 / (FRAMES - 1))


def test_what_a_probed_network_told_becomes_a_mean_over_the_thing() -> None:
    scene_, seen = world(truth={1: 2, 2: 1}, semantic={})
    told = np.full(2 * SIZE, np.nan, np.float32)
    told[: SIZE // 2] = 0.5
    asked = [FrameWithTruth(each.labelled, each.truth, {"entropy": told}) for each in seen]
    one, other = find_objects(scene_, asked)
    assert object_baselines(one.points, asked)["entropy"] == pytest.approx(0.5)
    assert "entropy" not in object_baselines(other.points, asked)
