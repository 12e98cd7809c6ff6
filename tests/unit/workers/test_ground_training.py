"""Training of GndNet on the ground found in simulated streets."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from workers.lab.datasets.ground_clouds import GroundCloud, cell_heights, clouds_of_streets, filled
from workers.lab.training import elevation, loop
from workers.lab.training.collect import split_items
from workers.lab.training.elevation import (
    GroundLearner,
    encoded,
    published_settings,
    sample_of,
    train_ground,
)
from workers.lab.training.elevation_loss import (
    DATA_WEIGHT,
    UNSEEN_WEIGHT,
    elevation_loss,
    seen_elevation_loss,
)
from workers.lab.training.run_state import Progress
from workers.lab.training.settings import TrainingSettings
from workers.paper.weights import GndNetCard, load_gndnet

SETTINGS = TrainingSettings(steps=3, batch=1, scorings=3, peak_rate=0.01)
CARD = GndNetCard(sensor_height_m=1.8, attribution="streets", data_license="none")


class KilledError(Exception):
    """The end of the process after a step."""


@pytest.fixture(scope="module")
def clouds(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("clouds") / "streets"
    made = clouds_of_streets(folder, streets=1, sensors=["hdl32"], seed=2, columns=360)
    assert made == clouds_of_streets(folder, streets=1, sensors=["hdl32"], seed=3)
    return made


@pytest.fixture
def sloping(tmp_path: Path, clouds: list[Path]) -> Path:
    """One of the clouds on a slope of 3 degrees to the side."""
    cloud, path = GroundCloud.read(clouds[0]), tmp_path / "sloping.npz"
    tilt = Rotation.from_euler("x", 3, degrees=True)
    replace(cloud, points_m=tilt.apply(cloud.points_m).astype(np.float32)).write(path)
    return path


def test_a_cell_has_the_median_height_and_gaps_are_filled_between_cells() -> None:
    ground = np.array([[-46.5, -49.5, z] for z in (1.0, 9.0, 2.0)] + [[-44.5, -49.5, 4.0]])
    ground = np.vstack((ground, [[-46.5, -40.5, 2.0], [200.0, 0, 7]]))
    heights = cell_heights(ground)
    assert np.isfinite(heights).sum() == 3
    assert heights[0, 0] == 2
    assert heights[0, 2] == 4
    whole = filled(heights)
    assert whole[0, 1] == pytest.approx(3)
    assert np.isfinite(whole).all()
    assert whole[0, 99] == 4
    heights[9, 0] = np.nan
    assert set(filled(heights).ravel()) == {2, 4}


def test_the_ground_of_a_street_is_level_over_the_road(clouds: list[Path]) -> None:
    cloud = GroundCloud.read(clouds[0])
    seen = sample_of(cloud, height_m=cloud.sensor_height_m).seen_m
    assert abs(float(np.nanmedian(seen))) < 0.2
    assert cloud.ground.mean() > 0.2


def test_the_loss_falls_and_a_killed_run_goes_on_to_the_same_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, clouds: list[Path]
) -> None:
    monkeypatch.setattr(loop, "STATE_EVERY_S", 0.0)

    def train(out: Path, *, kill_at: int = -1) -> Progress:
        def on_step(step: int) -> None:
            if step == kill_at:
                raise KilledError

        judged = {"street": clouds[-1:]}
        state = out.with_suffix(".state")
        return train_ground(
            clouds[:-1], judged, CARD, SETTINGS, out=out, state=state, on_step=on_step
        )

    whole, killed = tmp_path / "whole" / "gndnet.safetensors", tmp_path / "gndnet.safetensors"
    done = train(whole)
    assert done.curve[-1][1] < done.curve[0][1]
    assert done.scores["street height error m"] == pytest.approx(-done.best)
    with pytest.raises(KilledError):
        train(killed, kill_at=2)
    torch.manual_seed(99)
    train(killed)
    assert killed.read_bytes() == whole.read_bytes()
    assert load_gndnet(killed).card == load_gndnet(whole).card


def test_the_code_of_a_pillar_is_that_of_the_network(clouds: list[Path]) -> None:
    torch.manual_seed(1)
    net = CARD.build()
    whole = sample_of(GroundCloud.read(clouds[0]), height_m=1.8)
    # as if a pillar had as many places as the fullest has points
    sample = replace(whole, points=whole.points[:, : int(whole.counts.max())])
    with torch.inference_mode():
        expected = net.voxel_feature_extractor(sample.points, sample.counts, sample.cells_zyx)
        torch.testing.assert_close(encoded(net, sample, "cpu"), expected, atol=1e-4, rtol=1e-4)


def test_heights_and_places_are_alike_in_the_first_code_unless_published(
    clouds: list[Path],
) -> None:
    spans = {}
    for published in (False, True):
        torch.manual_seed(1)
        learner = GroundLearner(clouds, {}, CARD, replace(SETTINGS, published=published))
        sample = sample_of(GroundCloud.read(clouds[0]), height_m=1.8)
        higher = sample.points + torch.tensor([0.0, 0.0, 1.0, 0.0])
        empty = torch.arange(higher.shape[1])[None] >= sample.counts[:, None]
        raised = replace(sample, points=higher.masked_fill(empty[..., None], 0.0))
        with torch.inference_mode():
            one, other = (encoded(learner.net, each, "cpu") for each in (sample, raised))
        spans[published] = float((other - one).abs().mean() / one.std())
    assert spans[False] > 3 * spans[True]


def test_cells_with_ground_count_more_than_those_without_and_small_errors_count() -> None:
    truth, seen = torch.zeros(1, 4, 4), torch.zeros(1, 4, 4, dtype=torch.bool)
    seen[:, :, :2] = True
    level = torch.full((1, 4, 4), 1.0)
    within, without = torch.where(seen, level, truth), torch.where(seen, truth, level)
    data = [
        float(seen_elevation_loss(each, truth, seen) - elevation_loss(each, each))
        for each in (within, without)
    ]
    assert data[1] / data[0] == pytest.approx(UNSEEN_WEIGHT)
    assert data[0] == pytest.approx(DATA_WEIGHT * 0.975 / (1 + UNSEEN_WEIGHT))
    near = level * 0.1
    assert seen_elevation_loss(near, truth, seen) > 10 * elevation_loss(near, truth)


def test_one_slope_is_learnt_by_heart_as_the_network_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sloping: Path
) -> None:
    monkeypatch.setattr(elevation, "TILT_DEG", 0.0)
    settings = replace(
        SETTINGS, steps=24, scorings=1, peak_rate=3e-3, norm_momentum=0.3, bfloat16=True
    )
    seen_m = sample_of(GroundCloud.read(sloping), height_m=CARD.sensor_height_m).seen_m
    of_zero = float(np.nanmean(np.abs(seen_m)))
    done = train_ground(
        [sloping], {"street": [sloping]}, CARD, settings, out=tmp_path / "gndnet.safetensors"
    )
    assert of_zero > 0.3
    assert done.scores["street height error m"] < 0.5 * of_zero


def test_the_published_schedule_follows_from_the_clouds() -> None:
    found = published_settings(TrainingSettings(seed=7), clouds=5, epochs=120)
    assert (found.steps, found.batch, found.peak_rate, found.seed) == (360, 2, 0.01, 7)


def test_one_log_or_the_end_of_one_is_held_out() -> None:
    paths = [Path(str(number)) for number in range(10)]
    learnt, judged = split_items({"a": paths, "b": []})
    assert (learnt, judged) == ({"a": paths[:8]}, {"a": paths[8:]})
    learnt, judged = split_items(dict.fromkeys("abcdef", paths))
    assert list(learnt) == ["a", "b", "c", "d", "f"]
    assert list(judged) == ["e"]
    assert split_items({}) == ({}, {})
