"""Training of GndNet on the ground found in simulated streets."""

from pathlib import Path

import numpy as np
import pytest
import torch

from workers.lab.datasets.ground_clouds import GroundCloud, cell_heights, clouds_of_streets, filled
from workers.lab.training import loop
from workers.lab.training.collect import split_items
from workers.lab.training.elevation import published_settings, sample_of, train_ground
from workers.lab.training.run_state import Progress
from workers.lab.training.settings import TrainingSettings
from workers.paper.weights import GndNetCard, load_gndnet

SETTINGS = TrainingSettings(steps=3, batch=1, scorings=3, peak_rate=0.01)


class KilledError(Exception):
    """The end of the process after a step."""


@pytest.fixture(scope="module")
def clouds(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("clouds") / "streets"
    made = clouds_of_streets(folder, streets=1, sensors=["hdl32"], seed=2, columns=360)
    assert made == clouds_of_streets(folder, streets=1, sensors=["hdl32"], seed=3)
    return made


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
    card = GndNetCard(sensor_height_m=1.8, attribution="streets", data_license="none")

    def train(out: Path, *, kill_at: int = -1) -> Progress:
        def on_step(step: int) -> None:
            if step == kill_at:
                raise KilledError

        judged = {"street": clouds[-1:]}
        state = out.with_suffix(".state")
        return train_ground(
            clouds[:-1], judged, card, SETTINGS, out=out, state=state, on_step=on_step
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
