"""Label noise of a model on the car."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from workers.lab.labels.borders import borders_of
from workers.lab.labels.noise import LabelNoise
from workers.lab.labels.noise_settings import DYNAMIC, REAL, STATIC, NoiseSettings, SeenFrame

CAR, ROAD = 8, 1
QUIET = NoiseSettings(
    bleed_m=0.0,
    shadow_rad=0.0,
    inside_m=0.0,
    blobs_per_frame=0.0,
    flicker_share=0.0,
    late_share=0.0,
)
Labels = tuple[NDArray[np.uint8], NDArray[np.uint16]]


def seen_at(range_m: float) -> SeenFrame:
    """A box of points 1 m above the sensor's ground plane, on dense ground, before a wall."""
    side = np.linspace(-1.0, 1.0, 21)
    box = np.stack(np.meshgrid([range_m], side, side / 2), -1).reshape(-1, 3)
    across = np.arange(-4.0, 4.0, 0.1)
    ground = np.stack(np.meshgrid(range_m + across, across, [-0.6]), -1).reshape(-1, 3)
    wall = np.stack(np.meshgrid([range_m + 6.0], across, across / 4), -1).reshape(-1, 3)
    points_m = np.concatenate([box, ground, wall]).astype(np.float32)
    thing = np.where(np.arange(len(points_m)) < len(box), 0, -1)
    on_ground = (np.arange(len(points_m)) >= len(box)) & (points_m[:, 2] < -0.5)
    on_ground &= points_m[:, 0] < range_m + 5.0
    return SeenFrame(points_m, thing, on_ground, np.eye(4), borders_of(points_m, thing))


def right(seen: SeenFrame) -> Labels:
    mine = seen.thing >= 0
    return (
        np.where(mine, DYNAMIC, STATIC).astype(np.uint8),
        np.where(mine, CAR, ROAD).astype(np.uint16),
    )


def wrong_frames(settings: NoiseSettings, range_m: float, frames: int) -> list[float]:
    """Share of the box that is labelled static, in each frame."""
    seen = seen_at(range_m)
    noise = LabelNoise(5, (CAR,), settings)
    motion, class_id = right(seen)
    return [
        float((noise(seen, motion, class_id)[0][seen.thing == 0] == STATIC).mean())
        for _ in range(frames)
    ]


def test_without_strength_the_labels_stay() -> None:
    seen = seen_at(10.0)
    motion, class_id = right(seen)
    noisy = LabelNoise(1, (CAR,), QUIET)(seen, motion, class_id)
    np.testing.assert_array_equal(noisy[0], motion)
    np.testing.assert_array_equal(noisy[1], class_id)


def test_one_seed_gives_one_noise_and_leaves_its_input() -> None:
    seen = seen_at(10.0)
    motion, class_id = right(seen)
    before = motion.copy()

    def drive(seed: int) -> list[Labels]:
        noise = LabelNoise(seed, (CAR,), REAL)
        return [noise(seen, motion, class_id) for _ in range(5)]

    first, again, other = drive(1), drive(1), drive(2)
    assert all((a[0] == b[0]).all() for a, b in zip(first, again, strict=True))
    assert any((a[0] != b[0]).any() for a, b in zip(first, other, strict=True))
    np.testing.assert_array_equal(motion, before)


def test_a_label_bleeds_onto_near_points_and_takes_its_class_along() -> None:
    seen = seen_at(10.0)
    motion, class_id = right(seen)
    noisy = LabelNoise(1, (CAR,), replace(QUIET, bleed_m=0.4))(seen, motion, class_id)
    bled = (noisy[0] == DYNAMIC) & (seen.thing < 0)
    assert bled.sum() > 10
    assert (noisy[1][bled] == CAR).all()
    box = seen.points_m[seen.thing == 0]
    away_m = np.sqrt(((seen.points_m[bled, None] - box[None]) ** 2).sum(-1)).min(axis=1)
    assert away_m.max() < REAL.bleed_most_m


def test_a_shadow_lies_behind_the_outline_alone() -> None:
    seen = seen_at(10.0)
    settings = replace(QUIET, shadow_rad=float(np.radians(0.6)))
    motion, _ = LabelNoise(1, (CAR,), settings)(seen, *right(seen))
    bled = (motion == DYNAMIC) & (seen.thing < 0)
    assert bled.any()
    assert (np.linalg.norm(seen.points_m[bled], axis=1) > 10.5).all()


def test_the_border_of_an_object_takes_the_label_of_the_ground() -> None:
    settings = replace(QUIET, inside_m=0.3)
    shares = wrong_frames(settings, 10.0, 3)
    assert 0.0 < max(shares) < 0.5


@pytest.mark.parametrize(("range_m", "flickers"), [(10.0, False), (60.0, True)])
def test_movers_flicker_at_range_for_less_time_than_a_failure(
    range_m: float, flickers: bool
) -> None:
    shares = wrong_frames(replace(QUIET, flicker_share=1.0), range_m, 28)
    wrong = [share > 0.5 for share in shares]
    assert any(wrong) == flickers
    assert sum(wrong) < 5


def test_a_late_label_lies_where_the_object_was() -> None:
    seen = seen_at(10.0)
    noise = LabelNoise(1, (CAR,), replace(QUIET, late_share=1.0, rest_frames=0))
    motion, class_id = right(seen)
    assert (noise(seen, motion, class_id)[0][seen.thing == 0] == STATIC).all()
    ahead = np.eye(4)
    ahead[1, 3] = 1.0
    later = replace(seen, world_from_sensor=ahead)
    late = noise(later, motion, class_id)[0]
    mine = seen.thing == 0
    np.testing.assert_array_equal(late[mine] == DYNAMIC, seen.points_m[mine, 1] < 0.3 - 1e-3)
    assert ((late == DYNAMIC) & (seen.thing < 0)).any()


def test_blobs_last_less_time_than_a_failure_and_spare_objects() -> None:
    seen = seen_at(10.0)
    settings = replace(QUIET, blobs_per_frame=0.3, blob_moving_share=1.0)
    noise = LabelNoise(3, (CAR,), settings)
    motion, class_id = right(seen)
    frames = [noise(seen, motion, class_id) for _ in range(60)]
    blobs = np.array([(each[0] == DYNAMIC) & (seen.thing < 0) for each in frames])
    assert blobs.any()
    assert all((each[0] == motion)[seen.thing == 0].all() for each in frames)
    assert all((each[1] == CAR)[blob].all() for each, blob in zip(frames, blobs, strict=True))


def test_a_frame_without_objects_has_no_borders() -> None:
    points_m = np.ones((4, 3), np.float32)
    borders = borders_of(points_m, np.full(4, -1))
    assert not len(borders.around.index)
    assert not len(borders.behind.index)
    assert not len(borders.inside.index)
