from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.contradiction import ContradictionKind, Scene
from schemas.labels import Blindness, FrameHealth, MotionLabel
from tests.labelled_worlds import (
    CLASS_NAMES,
    START_NS,
    Thing,
    labelled_frame,
    labelled_scene,
    ranked_tracks,
)
from workers.contradiction.instances import find_instances
from workers.contradiction.temporal_context import MARGIN_M, dynamic_points_of, temporal_context_of
from workers.contradiction.track_features import TrackFeatures
from workers.contradiction.track_motion import Path, path_of
from workers.contradiction.tracks import centres_in_odom

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
SEMANTIC = ContradictionKind.ONLY_SEMANTIC_DYNAMIC


def _evidence(scene: Scene) -> TrackFeatures:
    (track,) = ranked_tracks(scene, find_instances(scene, class_names=CLASS_NAMES))
    return track.features


def _scene(
    said: Sequence[tuple[int, int]], *, step_m: float, others: tuple[Thing, ...] = ()
) -> Scene:
    """Return a scene of a car with other labels in each frame, and of other objects."""
    frames = []
    for number, (semantic, predictive) in enumerate(said):
        car = Thing((12.0 + step_m * number, 5.0, 0.0), semantic, predictive)
        frames.append(labelled_frame([car, *others], frame=number, time_s=number / 10.0))
    return Scene(scene_id=f"fleet/car-1/drive/lidar/{START_NS}", frames=tuple(frames))


@pytest.mark.parametrize(
    ("said", "before", "after"),
    [
        ([(DYNAMIC, DYNAMIC)] * 4 + [(DYNAMIC, STATIC)] * 6 + [(STATIC, STATIC)] * 4, 1.0, 0.0),
        ([(STATIC, STATIC)] * 4 + [(DYNAMIC, STATIC)] * 6 + [(DYNAMIC, DYNAMIC)] * 4, 0.0, 1.0),
        ([(STATIC, STATIC)] * 4 + [(DYNAMIC, STATIC)] * 6 + [(STATIC, STATIC)] * 4, 0.0, 0.0),
        ([(DYNAMIC, STATIC)] * 14, 0.0, 0.0),
    ],
    ids=["it stops", "it starts", "labelled dynamic for a while", "from end to end"],
)
@pytest.mark.parametrize("step_m", [0.0, 0.3], ids=["in its place", "as it goes"])
def test_dynamic_labels_of_both_streams_before_or_after_are_features(
    said: Sequence[tuple[int, int]], before: float, after: float, step_m: float
) -> None:
    evidence = _evidence(_scene(said, step_m=step_m))
    assert (evidence.agreed_before, evidence.not_refuted_after) == (before, after)


@pytest.mark.parametrize("step_m", [0.0, 0.3], ids=["in its place", "as it goes"])
def test_labels_beyond_the_ends_of_the_scene_count(step_m: float) -> None:
    said = [(DYNAMIC, DYNAMIC)] * 4 + [(DYNAMIC, STATIC)] * 10 + [(STATIC, STATIC)] * 4
    whole = _scene(said, step_m=step_m)
    cut = replace(whole, frames=whole.frames[4:14], before=whole.frames[1:4])
    alone = replace(cut, before=())
    assert (_evidence(cut).agreed_before, _evidence(cut).not_refuted_after) == (1.0, 0.0)
    assert _evidence(alone).agreed_before == 0.0


def test_a_mover_that_passes_next_to_an_object_does_not_count_for_it() -> None:
    said = [(STATIC, STATIC)] * 4 + [(DYNAMIC, STATIC)] * 6 + [(STATIC, STATIC)] * 4
    beside = Thing((12.0, 9.0, 0.0), DYNAMIC, DYNAMIC, points=400)
    evidence = _evidence(_scene(said, step_m=0.0, others=(beside,)))
    assert (evidence.agreed_before, evidence.not_refuted_after) == (0.0, 0.0)


def test_a_path_of_two_frames_has_no_velocity() -> None:
    centres_m = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    path = path_of(centres_m, np.array([0.0, 0.1]), [centres_m[:1, :2], centres_m[1:, :2]])
    assert (path.displacement, path.straightness) == (0.0, 0.0)
    assert not path.velocity_m_per_s.any()


def _seen_from(begin_m: NDArray[np.float64], end_m: NDArray[np.float64]) -> Path:
    """Return the path of an object observed between two ends in each frame."""
    ends_m = np.stack([begin_m, end_m], axis=1)
    share = np.linspace(0.0, 1.0, 50)
    places_m = [
        np.stack([low + share * (high - low), np.full(50, 5.0)], axis=1) for low, high in ends_m
    ]
    centres_m = np.array([[each.mean(), 5.0, 0.0] for each in ends_m])
    return path_of(centres_m, np.arange(len(ends_m)) / 10.0, places_m)


def test_a_static_object_unveiled_at_one_end_has_no_displacement() -> None:
    shown = np.linspace(1.0, 4.0, 11)
    unveiled = _seen_from(np.zeros(11), shown)
    covered = _seen_from(4.0 - shown, np.full(11, 4.0))
    driven = _seen_from(shown - 1.0, shown + 3.0)
    # 3 m more of it are seen, or 3 m less
    assert max(unveiled.displacement, covered.displacement) < 0.05
    assert max(unveiled.straightness, covered.straightness) < 0.2
    assert driven.displacement == pytest.approx(0.75)
    assert driven.straightness > 0.9
    assert np.allclose(unveiled.velocity_m_per_s, [1.5, 0.0])


def test_the_displacement_of_an_emerging_object_is_that_of_its_slower_end() -> None:
    coming = _seen_from(np.linspace(0.0, 1.0, 11), np.linspace(0.5, 5.0, 11))
    assert 0.45 < coming.displacement < 0.6


@pytest.mark.parametrize(
    ("after", "agreed"),
    [((DYNAMIC, UNKNOWN), 1.0), ((STATIC, UNKNOWN), 0.0), ((UNKNOWN, UNKNOWN), 0.0)],
    ids=["only the supervised stream labels it", "the alarm is over", "no stream labels it"],
)
def test_an_object_no_longer_labelled_static_is_not_refuted(
    after: tuple[int, int], agreed: float
) -> None:
    said = [(STATIC, STATIC)] * 4 + [(DYNAMIC, STATIC)] * 6 + [after] * 4
    assert _evidence(_scene(said, step_m=0.05)).not_refuted_after == agreed


def test_an_object_that_moves_on_while_labelled_static_differs_from_one_that_stops() -> None:
    said = [(DYNAMIC, DYNAMIC)] * 4 + [(STATIC, DYNAMIC)] * 6 + [(DYNAMIC, DYNAMIC)] * 4
    goes, stands = _evidence(_scene(said, step_m=0.5)), _evidence(_scene(said, step_m=0.0))
    assert min(goes.agreed_before, goes.not_refuted_after) > 0.8
    assert (stands.agreed_before, stands.not_refuted_after) == (0.0, 0.0)


def test_an_unlabelled_new_object_is_not_agreed_dynamic() -> None:
    said = [(DYNAMIC, UNKNOWN)] * 4 + [(DYNAMIC, STATIC)] * 6
    assert _evidence(_scene(said, step_m=0.0)).agreed_before == 0.0


def test_a_blind_stream_does_not_count_as_not_refuting() -> None:
    said = [(STATIC, STATIC)] * 4 + [(DYNAMIC, STATIC)] * 6 + [(DYNAMIC, UNKNOWN)] * 4
    scene = _scene(said, step_m=0.0)
    blind = FrameHealth(blindness=Blindness.NO_PAST, reason="a jump")
    frames = [
        replace(each, predictive=replace(each.predictive, health=blind)) if number >= 10 else each
        for number, each in enumerate(scene.frames)
    ]
    assert _evidence(replace(scene, frames=tuple(frames))).not_refuted_after == 0.0


@pytest.mark.parametrize(
    ("height_m", "range_m", "least", "most"),
    [(0.3, 10.0, 0.75, 0.85), (1.5, 10.0, 0.0, 0.0), (0.3, 60.0, 0.0, 0.0)],
    ids=["a lifted patch of road", "a car", "a far car of few rows"],
)
def test_a_near_box_without_height_is_low(
    height_m: float, range_m: float, least: float, most: float
) -> None:
    thing = Thing((range_m, 0.0, 0.0), DYNAMIC, STATIC, size_m=(3.0, 1.5, height_m))
    assert least <= _evidence(labelled_scene([replace(thing, points=200)])).lowness <= most


def test_agreed_dynamic_labels_count_up_to_a_second_away() -> None:
    gap = [(STATIC, STATIC)]
    for frames_between, agreed in ((5, 1.0), (9, 2 / 3), (12, 0.0)):
        said = [(DYNAMIC, DYNAMIC)] * 3 + gap * (frames_between - 1) + [(DYNAMIC, STATIC)] * 6
        evidence = _evidence(_scene(said, step_m=0.0))
        assert evidence.agreed_before == pytest.approx(agreed), frames_between


def test_fragments_in_a_track_do_not_hide_that_it_starts() -> None:
    late = frozenset(range(8, 14))
    scrap = Thing((12.0, 5.0, 0.0), DYNAMIC, STATIC, (1.0, 0.5, 0.5), points=30, frames=late)
    said = [(STATIC, STATIC)] * 4 + [(DYNAMIC, STATIC)] * 4 + [(DYNAMIC, DYNAMIC)] * 6
    scene = _scene(said, step_m=0.0, others=(scrap,))
    (track,) = ranked_tracks(scene, find_instances(scene, class_names=CLASS_NAMES))
    assert max(track.track.members) == len(track.track.members) - 1 == 9  # to the last frame
    assert track.features.not_refuted_after == 1.0


@pytest.mark.parametrize(
    ("said", "before", "after"),
    [
        ([(DYNAMIC, UNKNOWN)] * 4 + [(STATIC, DYNAMIC)] * 6 + [(STATIC, STATIC)] * 4, 1.0, 0.0),
        ([(STATIC, UNKNOWN)] * 4 + [(STATIC, DYNAMIC)] * 6 + [(DYNAMIC, STATIC)] * 4, 0.0, 1.0),
        ([(STATIC, UNKNOWN)] * 4 + [(STATIC, DYNAMIC)] * 6 + [(STATIC, STATIC)] * 4, 0.0, 0.0),
    ],
    ids=["supervised label dynamic earlier", "supervised label dynamic later", "never"],
)
def test_changes_of_the_supervised_label_are_features(
    said: Sequence[tuple[int, int]], before: float, after: float
) -> None:
    scene = _scene(said, step_m=0.3)
    (track,) = (
        track
        for track in ranked_tracks(scene, find_instances(scene, class_names=CLASS_NAMES))
        if track.track.kind.measured
    )
    assert (track.features.dynamic_before, track.features.dynamic_after) == (before, after)


def test_the_points_in_a_box_are_those_that_a_plain_search_finds() -> None:
    rng = np.random.default_rng(3)
    things = [
        Thing((float(x), float(y), 0.0), DYNAMIC, (STATIC, DYNAMIC, UNKNOWN)[k % 3], points=30)
        for k, (x, y) in enumerate(rng.uniform(-20.0, 20.0, (40, 2)))
    ]
    turned = np.eye(4)
    turned[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
    turned[:3, 3] = (900.0, -300.0, 2.0)
    frames = [
        labelled_frame(
            [
                replace(each, at_m=(each.at_m[0] + 900.0, each.at_m[1] - 300.0, 2.0))
                for each in part
            ],
            frame=number,
            time_s=number / 10.0,
            odom_from_sensor=turned,
        )
        for number, part in enumerate((things[:30], things, things[10:]))
    ]
    scene = Scene(scene_id="fleet/car-1/drive/lidar/0", frames=tuple(frames))
    dynamic_points = dynamic_points_of(scene)
    instances = find_instances(scene, class_names=CLASS_NAMES)
    assert len(instances) > 20
    for instance in instances:
        found = temporal_context_of(
            *(scene, [instance], centres_in_odom(scene, [instance]), np.zeros(2), dynamic_points),
            period_s=0.3,
        )
        shares = []
        for frame in scene.frames:
            moves = np.flatnonzero(frame.semantic.labels == DYNAMIC)
            away_m = frame.posed.frame.points_m[moves] - instance.centre_m
            turn = np.array([[np.cos(instance.yaw_rad), np.sin(instance.yaw_rad)]])
            along, across = away_m[:, :2] @ turn[0], away_m[:, :2] @ (turn[0, ::-1] * [-1, 1])
            box = np.abs(np.stack([along, across, away_m[:, 2]], axis=1))
            inside = (box <= instance.size_m / 2 + MARGIN_M).all(axis=1)
            shares.append(min(1.0, inside.sum() / (0.5 * len(instance.point_index))))
        at = instance.frame_index
        assert found.dynamic_before == pytest.approx(max(shares[:at], default=0.0))
        assert found.dynamic_after == pytest.approx(max(shares[at:]))
