from pathlib import Path

import numpy as np
import pytest
import torch

from tests.factories import frame
from workers.lab.datasets.classes import CLASSES
from workers.lab.datasets.images import Cloud, TrainingImages, build_images
from workers.lab.datasets.simulated import clouds_of
from workers.lab.datasets.stored_images import join, read_images, write_images
from workers.lab.simulation.output.samples import street_samples
from workers.lab.training.augment import Sample, augment, network_input
from workers.lab.training.batches import TrainingSet
from workers.lab.training.loss import class_weights, lovasz_softmax, segmentation_loss
from workers.lab.training.segmentation import train
from workers.lab.training.settings import TrainingSettings
from workers.lidar.range_image import SensorProfile
from workers.supervised.classes import ClassMeaning
from workers.supervised.lmnet import MOTION_CLASSES
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.weights import WeightsCard, load_weights

PROFILE = SensorProfile(name="test", rows=16, columns=64, fov_up_deg=20, fov_down_deg=-20)
RESIDUAL = ResidualSettings(ages_s=(0.1, 0.2), max_range_m=100)
CARD = WeightsCard(
    network="lmnet",
    classes=tuple(ClassMeaning(name=name) for name in MOTION_CLASSES),
    width=4,
    profile=PROFILE,
    residual=RESIDUAL,
    attribution="made in a test",
    data_license="CC0",
    training={},
)


def _street(frames: int) -> list[Cloud]:
    """A wall all around, and a thing that drives through the view, 1 m per frame."""
    azimuth = np.linspace(-np.pi, np.pi, 400, endpoint=False)
    clouds = []
    for number in range(frames):
        thing = (azimuth > -0.3) & (azimuth < 0.3)
        distance = np.where(thing, 10.0 + number, 30.0)
        rings = [
            np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth), distance * up], 1)
            for up in np.tan(np.radians(np.linspace(-18, 18, 16)))
        ]
        clouds.append(
            Cloud(
                frame(np.concatenate(rings), at_s=number / 10),
                semantic=np.tile(np.where(thing, 1, 9), 16).astype(np.uint8),
                motion=np.tile(np.where(thing, 2, 1), 16).astype(np.uint8),
                world_from_sensor=np.eye(4),
            )
        )
    return clouds


def images_of_a_wall(frames: int = 4, *, variants: tuple[int, ...] = (1, -1)) -> TrainingImages:
    rng = np.random.default_rng(1)
    return build_images(_street(frames), PROFILE, RESIDUAL, variants=variants, rng=rng)


def test_only_what_moves_has_a_residual_forwards_and_backwards() -> None:
    images = images_of_a_wall()
    assert images.residuals.shape == (4, 2, 2, 16, 64)
    middle = images.residuals[2].astype(np.float32)
    moving, still = images.motion[2] == 2, images.motion[2] == 1
    assert np.median(middle[0, 1][moving]) == pytest.approx(2 / 12, abs=0.02)  # 0.2 s before
    assert np.median(middle[1, 0][moving]) == pytest.approx(1 / 12, abs=0.02)  # 0.1 s after
    assert np.median(middle[:, :, still]) < 0.01


def test_played_at_double_speed_things_move_twice_as_far() -> None:
    images = images_of_a_wall(frames=5, variants=(1, 2))
    moving = images.motion[4] == 2
    single, double = images.residuals[4].astype(np.float32)
    assert np.median(single[0][moving]) == pytest.approx(1 / 14, abs=0.02)
    assert np.median(double[0][moving]) == pytest.approx(2 / 14, abs=0.02)


def test_images_are_made_of_chosen_frames_but_compared_with_all() -> None:
    rng = np.random.default_rng(1)
    images = build_images(_street(4), PROFILE, RESIDUAL, variants=(1,), rng=rng, only=range(3, 4))
    assert len(images.channels) == 1
    assert (images.residuals[0, 0, 1] > 0).any()


def _sample(seed: int, *, columns: int = 64) -> tuple[Sample, Sample]:
    images = images_of_a_wall()
    whole = Sample(
        images.channels[2],
        images.residuals[2, 0].astype(np.float32),
        images.seen_mask[2],
        images.motion[2],
    )
    return whole, augment(whole, np.random.default_rng(seed), columns=columns)


@pytest.mark.parametrize("seed", range(8))
def test_however_turned_and_mirrored_a_point_stays_in_the_column_of_its_azimuth(seed: int) -> None:
    _, changed = _sample(seed)
    seen = changed.seen_mask
    azimuth = np.arctan2(changed.channels[2][seen], changed.channels[1][seen])
    column = (0.5 * (1 - azimuth / np.pi) * 64) % 64
    apart = np.abs(column - (np.nonzero(seen)[1] + 0.5))
    assert np.minimum(apart, 64 - apart).max() <= 0.55


@pytest.mark.parametrize("seed", range(8))
def test_labels_and_residuals_move_with_their_pixels(seed: int) -> None:
    _, changed = _sample(seed)
    moving = changed.labels == 2
    still = changed.labels == 1
    assert moving.any()
    assert np.median(changed.channels[0][moving]) < 15 < np.median(changed.channels[0][still])
    assert changed.residuals[0][moving].mean() > 5 * changed.residuals[0][still].mean()
    assert (changed.labels[~changed.seen_mask] == 0).all()


def test_augmenting_changes_no_original() -> None:
    whole, _ = _sample(3)
    np.testing.assert_array_equal(whole.channels, images_of_a_wall().channels[2])
    np.testing.assert_array_equal(whole.labels, images_of_a_wall().motion[2])


def test_a_window_is_as_wide_as_asked_and_empty_pixels_are_zero() -> None:
    _, changed = _sample(0, columns=32)
    x = network_input(changed, PROFILE)
    assert x.shape == (7, 16, 32)
    assert x.dtype == np.float32
    assert (x[:, ~changed.seen_mask] == 0).all()


def test_rare_classes_weigh_more_and_the_ignored_one_nothing() -> None:
    drawn = np.array([50.0, 90.0, 10.0])
    weights = class_weights(drawn)
    torch.testing.assert_close(weights, torch.tensor([0.0, 1 / 0.901, 1 / 0.101]))
    assert class_weights(drawn, balance=0.0).tolist() == [0.0, 1.0, 1.0]
    assert drawn.tolist() == [50.0, 90.0, 10.0]


def test_nothing_is_lost_where_everything_is_ignored() -> None:
    shares = torch.full((1, 3, 2, 2), 1 / 3)
    assert float(lovasz_softmax(shares, torch.zeros(1, 2, 2, dtype=torch.int64))) == 0


def test_windows_without_a_label_teach_nothing_and_are_no_error() -> None:
    logits = torch.zeros(1, 3, 2, 2, requires_grad=True)
    loss = segmentation_loss(logits, torch.zeros(1, 2, 2, dtype=torch.int64), torch.ones(3))
    assert float(loss.detach()) == 0


def _trained(path: Path, seed: int) -> bytes:
    torch.set_num_threads(1)
    settings = TrainingSettings(steps=3, columns=32, seed=seed)
    training_sets = [
        TrainingSet(images_of_a_wall(), 1.0),
        TrainingSet(images_of_a_wall(frames=5), 3.0),
    ]
    held_out = {"held out": TrainingSet(images_of_a_wall(variants=(1,)), 1.0)}
    train(training_sets, held_out, CARD, settings, out=path)
    return path.read_bytes()


def test_the_same_seed_gives_the_same_weights_and_they_load(tmp_path: Path) -> None:
    first = _trained(tmp_path / "one.safetensors", seed=1)
    assert _trained(tmp_path / "two.safetensors", seed=1) == first
    assert _trained(tmp_path / "three.safetensors", seed=2) != first
    card = load_weights(tmp_path / "one.safetensors").card
    assert set(card.scores) == {"held out static", "held out moving"}


def test_fixed_norms_stay_what_they_were_while_everything_else_learns(tmp_path: Path) -> None:
    torch.set_num_threads(1)
    _trained(tmp_path / "first.safetensors", seed=1)
    initial = load_weights(tmp_path / "first.safetensors")
    settings = TrainingSettings(steps=2, columns=32, fixed_norms=1.0)
    out = tmp_path / "second.safetensors"
    train([TrainingSet(images_of_a_wall(), 1.0)], {}, CARD, settings, initial=initial, out=out)
    before, after = initial.net.state_dict(), load_weights(out).net.state_dict()
    running = [name for name in before if "running" in name]
    assert running
    assert all(torch.equal(before[name], after[name]) for name in running)
    assert not torch.equal(before["logits.weight"], after["logits.weight"])


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_norms_are_fixed_for_the_last_share_of_the_steps(tmp_path: Path, share: float) -> None:
    torch.set_num_threads(1)
    settings = TrainingSettings(steps=4, columns=32, fixed_norms=share)
    train(
        [TrainingSet(images_of_a_wall(), 1.0)], {}, CARD, settings, out=tmp_path / "w.safetensors"
    )
    parameters = load_weights(tmp_path / "w.safetensors").net.state_dict()
    batches = {int(value) for name, value in parameters.items() if "num_batches" in name}
    assert batches == {round(4 * (1 - share))}


def test_of_a_lovasz_loss_over_each_second_pixel_only_these_count() -> None:
    rng = np.random.default_rng(1)
    shares = torch.softmax(torch.from_numpy(rng.normal(size=(1, 3, 4, 8))).float(), dim=1)
    labels = torch.from_numpy(rng.integers(1, 3, size=(1, 4, 8)))
    halved = lovasz_softmax(shares[..., ::2], labels[..., ::2])
    torch.testing.assert_close(lovasz_softmax(shares, labels, every=2), halved)
    assert not torch.isclose(lovasz_softmax(shares, labels), halved)
    weights = torch.ones(3)
    whole = segmentation_loss(shares.log(), labels, weights)
    fewer = segmentation_loss(shares.log(), labels, weights, lovasz_every=2)
    torch.testing.assert_close(whole - fewer, lovasz_softmax(shares, labels) - halved)


def test_bfloat16_teaches_much_the_same(tmp_path: Path) -> None:
    torch.set_num_threads(1)
    trained = []
    for half in (False, True):
        out = tmp_path / f"{half}.safetensors"
        settings = TrainingSettings(steps=3, columns=32, bfloat16=half)
        train([TrainingSet(images_of_a_wall(), 1.0)], {}, CARD, settings, out=out)
        trained.append(load_weights(out).net.logits.weight.detach())
    single, half_precise = trained
    assert not torch.equal(single, half_precise)
    torch.testing.assert_close(single, half_precise, atol=0.02, rtol=0)


def test_images_of_a_sensor_are_joined_written_and_read_back(tmp_path: Path) -> None:
    both = join([images_of_a_wall(), images_of_a_wall()])
    write_images(tmp_path / "wall", both, source={"seeds": "1:3"})
    images, source = read_images(tmp_path / "wall")
    assert source == {"seeds": "1:3"}
    assert len(images.channels) == 8
    np.testing.assert_allclose(images.channels, both.channels, atol=0.02)
    np.testing.assert_array_equal(images.residuals, both.residuals)


def test_simulated_streets_are_clouds_with_truth() -> None:
    (sample,) = street_samples(3, streets=1, windows=1, frames=3, sensors=["vlp32c"], columns=256)
    first, second = clouds_of(sample)
    assert second.frame.stamp_ns - first.frame.stamp_ns == 100_000_000
    assert len(first.semantic) == len(first.motion) == len(first.frame)
    assert set(np.unique(first.frame.ring)) <= set(range(32))
    assert {"road"} < {CLASSES[each][0] for each in np.unique(first.semantic)}
