import numpy as np

from schemas.contradiction import Instance, Scene
from schemas.labels import MotionLabel
from tests.labelled_worlds import CLASS_NAMES, Thing, labelled_scene
from workers.contradiction.instances import find_instances
from workers.contradiction.tracks import Track, associate_instances

STATIC, DYNAMIC = MotionLabel.STATIC, MotionLabel.DYNAMIC


def _tied(scene: Scene) -> tuple[tuple[Instance, ...], tuple[Track, ...]]:
    instances = find_instances(scene, class_names=CLASS_NAMES)
    return instances, associate_instances(scene, instances)


def test_a_fast_car_that_one_stream_misses_is_one_track() -> None:
    car = Thing((-30, 3, 0), STATIC, DYNAMIC, velocity_m_per_s=(25, 0, 0))
    _, tracks = _tied(labelled_scene([car]))
    assert [len(track.members) for track in tracks] == [20]
    np.testing.assert_allclose(
        tracks[0].centres_m[-1] - tracks[0].centres_m[0], (25 * 1.9, 0, 0), atol=0.2
    )


def test_a_parked_car_stays_one_track_while_we_drive_past_it() -> None:
    parked = Thing((20, 3, 0), DYNAMIC, STATIC)
    _, tracks = _tied(labelled_scene([parked], ego_m_per_s=15))
    assert [len(track.members) for track in tracks] == [20]
    np.testing.assert_allclose(np.ptp(tracks[0].centres_m, axis=0), 0, atol=0.05)


def test_a_mover_without_a_measured_speed_is_followed_by_its_own_path() -> None:
    cyclist = Thing((5, -4, 0), DYNAMIC, STATIC, size_m=(1.8, 0.6, 1.7), velocity_m_per_s=(6, 0, 0))
    _, tracks = _tied(labelled_scene([cyclist]))
    assert [len(track.members) for track in tracks] == [20]


def test_two_cars_that_meet_keep_their_own_tracks() -> None:
    one = Thing((-16, 1.6, 0), STATIC, DYNAMIC, velocity_m_per_s=(15, 0, 0))
    other = Thing((16, -1.6, 0), STATIC, DYNAMIC, velocity_m_per_s=(-15, 0, 0), points=140)
    _, tracks = _tied(labelled_scene([one, other]))
    assert [len(track.members) for track in tracks] == [20, 20]
    for track in tracks:
        steps = np.diff(track.centres_m[:, 0])
        assert (np.sign(steps) == np.sign(steps[0])).all()


def test_a_short_miss_does_not_end_a_track_and_a_long_one_does() -> None:
    seen = Thing((10, 0, 0), DYNAMIC, STATIC, frames=frozenset(range(20)) - {5, 6})
    lost = Thing((10, 20, 0), DYNAMIC, STATIC, frames=frozenset(range(20)) - set(range(5, 10)))
    _, tracks = _tied(labelled_scene([seen, lost]))
    assert sorted(len(track.members) for track in tracks) == [5, 10, 18]


def test_instances_of_a_slow_sensor_are_associated_by_time_not_by_frames() -> None:
    car = Thing((-10, 3, 0), STATIC, DYNAMIC, velocity_m_per_s=(10, 0, 0))
    _, tracks = _tied(labelled_scene([car], frames=5, period_s=0.5))
    assert [len(track.members) for track in tracks] == [5]


def test_two_kinds_are_never_in_one_track() -> None:
    first = Thing((10, 0, 0), DYNAMIC, STATIC, frames=frozenset(range(10)))
    then = Thing((10, 0, 0), STATIC, DYNAMIC, frames=frozenset(range(10, 20)))
    _, tracks = _tied(labelled_scene([first, then]))
    assert [len(track.members) for track in tracks] == [10, 10]
    assert len({track.kind for track in tracks}) == 2


def test_a_car_split_by_a_pole_continues_as_its_larger_part() -> None:
    everywhere = frozenset(range(20))
    whole = Thing((10, 0, 0), DYNAMIC, STATIC, frames=everywhere - {8, 9})
    front = Thing((10.6, 0, 0), DYNAMIC, STATIC, size_m=(2.8, 1.8, 1.5), frames=frozenset({8, 9}))
    tail = Thing(
        (7.9, 0, 0), DYNAMIC, STATIC, size_m=(0.2, 1.8, 1.5), points=40, frames=frozenset({8, 9})
    )
    instances, tracks = _tied(labelled_scene([whole, tail, front]))
    longest = max(tracks, key=lambda track: len(track.members))
    assert len(longest.members) == 20
    assert all(instances[member].size_m[0] > 2 for member in longest.members)


def test_every_instance_is_in_exactly_one_track() -> None:
    things = [
        Thing((8.0 * i, 4.0 * (i % 3), 0), DYNAMIC, STATIC, points=20 + i, size_m=(1, 1, 1))
        for i in range(12)
    ]
    instances, tracks = _tied(labelled_scene(things, frames=6))
    members = sorted(member for track in tracks for member in track.members)
    assert members == list(range(len(instances)))


def test_no_instances_make_no_tracks() -> None:
    scene = labelled_scene([Thing((10, 0, 0), STATIC, STATIC)], frames=3)
    assert associate_instances(scene, ()) == ()
