"""Places of an object's shape, earlier and later, whatever its labels."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from schemas.contradiction import Scene
from schemas.labels import MotionLabel
from tests.labelled_worlds import CLASS_NAMES, START_NS, Thing, labelled_frame, ranked_tracks
from workers.contradiction.feature_extraction import places_in_odom
from workers.contradiction.instances import find_instances
from workers.contradiction.keyframes import EVERY_S, Keyframes
from workers.contradiction.shape_persistence import ShapePersistence, shape_persistence_of
from workers.contradiction.track_motion import velocity_of
from workers.contradiction.tracks import associate_instances

STATIC, DYNAMIC = MotionLabel.STATIC, MotionLabel.DYNAMIC
WALL = Thing((16.0, 12.0, 0.0), STATIC, STATIC, (30.0, 0.1, 3.0), points=3000, class_id=0)
PERSON_M = (0.1, 0.6, 1.7)
"""Observed size of a person, metres: the side towards the lidar."""


def _scene(
    along_m: Callable[[float], float],
    *,
    frames: int = 30,
    contradicts: Sequence[int] = range(10, 20),
    seen: Callable[[int], bool] = lambda _: True,
    size_m: tuple[float, float, float] = PERSON_M,
    others: Sequence[Thing] = (WALL,),
    instead: Sequence[Thing] = (),
) -> Scene:
    """Something that is somewhere along x at each time, and is called moving in some frames.

    In those in which it is not seen there may be something instead.
    """
    made = []
    for number in range(frames):
        says = DYNAMIC if number in contradicts else STATIC
        thing = Thing((12.0 + along_m(number / 10), 5.0, 0.0), says, STATIC, size_m)
        # the same shape wherever it is: its points hang on how its place reads
        body = Thing((10.0, 5.0, 0.0), says, STATIC, size_m).placed(0.0)
        shown = [thing] if seen(number) else []
        beside = others if shown else (*instead, *others)
        frame = labelled_frame([*shown, *beside], frame=number, time_s=number / 10)
        if shown:
            frame.posed.frame.points_m.setflags(write=True)
            frame.posed.frame.points_m[: len(body)] = body
            frame.posed.frame.points_m[: len(body), 0] += 2.0 + along_m(number / 10)
            frame.posed.frame.points_m.setflags(write=False)
        made.append(frame)
    inside = made[contradicts[0] : contradicts[-1] + 1]
    return Scene(
        scene_id=f"fleet/car-1/drive/lidar/{START_NS}",
        frames=tuple(inside),
        before=tuple(made[: contradicts[0]]),
        after=tuple(made[contradicts[-1] + 1 :]),
    )


def _persistence_in(scene: Scene) -> ShapePersistence:
    instances = find_instances(scene, class_names=CLASS_NAMES)
    (track,) = associate_instances(scene, instances)
    members = [instances[each] for each in track.members]
    stamps_s = np.array([scene.frames[m.frame_index].stamp_ns / 1e9 for m in members])
    velocity = velocity_of(track.centres_m, stamps_s)
    places_m = places_in_odom(scene, members)
    return shape_persistence_of(scene, members, places_m, velocity, Keyframes(scene))


@pytest.mark.parametrize(
    ("along_m", "expected"),
    [
        (lambda _: 0.0, ShapePersistence(1.0, 0.0, 1.0, 0.0)),
        (lambda time_s: 0.5 * time_s, ShapePersistence(0.0, 1.0, 0.0, 1.0)),
        (lambda time_s: 0.8 * min(0.0, time_s - 1.2), ShapePersistence(0.0, 1.0, 1.0, 0.0)),
        (lambda time_s: 0.8 * max(0.0, time_s - 1.7), ShapePersistence(1.0, 0.0, 0.0, 1.0)),
        (lambda time_s: 14.0 * time_s, ShapePersistence(0.0, 1.0, 0.0, 1.0)),
    ],
    ids=["it stands", "it strolls", "it stops", "it starts", "it is fast"],
)
def test_the_places_of_a_shape_earlier_and_later_are_found(
    along_m: Callable[[float], float], expected: ShapePersistence
) -> None:
    found = _persistence_in(_scene(along_m))
    assert found.here_before == pytest.approx(expected.here_before, abs=0.15)
    assert found.elsewhere_before == pytest.approx(expected.elsewhere_before, abs=0.15)
    assert found.here_after == pytest.approx(expected.here_after, abs=0.15)
    assert found.elsewhere_after == pytest.approx(expected.elsewhere_after, abs=0.15)


def test_an_object_hidden_before_and_after_has_no_evidence() -> None:
    assert (
        _persistence_in(_scene(lambda _: 0.0, seen=lambda frame: 13 <= frame < 17))
        == ShapePersistence()
    )


def test_beyond_the_log_there_is_no_evidence() -> None:
    found = _persistence_in(_scene(lambda _: 0.0, frames=14))
    assert (found.here_before, found.elsewhere_before) == (1.0, 0.0)
    assert (found.here_after, found.elsewhere_after) == (0.0, 0.0)


def test_a_shape_half_hidden_at_other_times_is_static() -> None:
    hides = Thing((12.0, 4.6, 0.0), STATIC, STATIC, (4.0, 0.4, 1.5), points=400)
    scene = _scene(lambda _: 0.0, size_m=(4.0, 1.8, 1.5), others=(WALL, hides))
    assert _persistence_in(scene) == ShapePersistence(1.0, 0.0, 1.0, 0.0)


def test_keyframes_in_which_it_is_occluded_are_left_out() -> None:
    lorry = Thing((6.0, 2.5, 0.0), STATIC, STATIC, (5.0, 0.2, 3.0), points=6000)
    wall = Thing((16.0, -12.0, 0.0), STATIC, STATIC, WALL.size_m, points=3000, class_id=0)
    for instead, here in (((lorry,), 1.0), ((), 0.0)):
        seen = [n for n in range(30) if n not in (0, 5, 20, 25)]
        found = _persistence_in(
            _scene(lambda _: 0.0, seen=seen.__contains__, others=(wall,), instead=instead)
        )
        assert (found.here_before, found.here_after) == (here, here)
        assert (found.elsewhere_before, found.elsewhere_after) == (0.0, 0.0)


def test_a_piece_of_a_rail_that_is_sometimes_unobserved_did_not_arrive() -> None:
    rail = Thing((20.0, 5.0, 0.0), STATIC, STATIC, (14.0, 0.1, 0.6), points=1500, class_id=0)
    found = _persistence_in(
        _scene(
            lambda _: 0.0,
            contradicts=range(14, 24),
            seen=lambda n: n != 5,
            size_m=(4.0, 0.1, 0.6),
            others=(WALL, rail),
        )
    )
    assert found.elsewhere_before == 0.0


def test_an_object_above_a_place_is_not_in_it() -> None:
    crown = Thing((12.0, 5.0, 4.0), STATIC, STATIC, (6.0, 6.0, 2.0), points=4000, class_id=0)
    found = _persistence_in(_scene(lambda time_s: 0.5 * time_s, others=(WALL, crown)))
    assert min(found.elsewhere_before, found.elsewhere_after) > 0.8


@pytest.mark.parametrize(
    ("along_m", "passes"),
    [(lambda time_s: 0.5 * time_s, 1.0), (lambda time_s: 0.8 * min(0.0, time_s - 1.2), 0.0)],
    ids=["it strolls", "it stops"],
)
def test_an_object_that_arrived_and_departs_transits(
    along_m: Callable[[float], float], passes: float
) -> None:
    scene = _scene(along_m)
    (track,) = ranked_tracks(scene, find_instances(scene, class_names=CLASS_NAMES))
    assert track.features.arrived == pytest.approx(1.0, abs=0.15)
    assert track.features.transits == pytest.approx(passes, abs=0.15)


def test_shapes_are_tested_for_lasting_tracks_with_points() -> None:
    lasting, brief = (
        ranked_tracks(scene, find_instances(scene, class_names=CLASS_NAMES))[0].features
        for scene in (
            _scene(lambda _: 0.0),
            _scene(lambda _: 0.0, contradicts=range(10, 11)),
        )
    )
    assert (lasting.shape_static, lasting.shape_static_after) == (1.0, 1.0)
    assert (brief.shape_static, brief.shape_static_after) == (0.0, 0.0)


def test_a_keyframe_is_taken_every_half_second_at_any_frame_rate() -> None:
    for period_s in (0.05, 0.1, 0.2, 1.0):
        frames = tuple(
            labelled_frame([WALL], frame=n, time_s=n * period_s) for n in range(round(3 / period_s))
        )
        scene = Scene(f"fleet/car-1/drive/lidar/{START_NS}", frames)
        steps_s = np.diff(Keyframes(scene).stamps_ns) / 1e9
        assert (steps_s >= EVERY_S).all()
        assert (steps_s <= max(EVERY_S + period_s, period_s)).all()
