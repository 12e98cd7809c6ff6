"""Training of FlowStep3D on pairs of clouds without labels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from workers.lab.datasets.flow_clouds import FlowCloud, clouds_of_streets
from workers.lab.datasets.frame_files import Pair, pairs_of
from workers.lab.training import loop
from workers.lab.training.errors import TrainingDivergedError
from workers.lab.training.run_state import Progress
from workers.lab.training.scene_flow import (
    DEFAULT,
    PUBLISHED,
    augmented,
    drawn,
    published_settings,
    recipe_of,
    train_flow,
)
from workers.lab.training.settings import TrainingSettings
from workers.lab.training.teach_flow import FlowTask
from workers.paper.learned_flow import REACH_M, FlowStep3DFlow
from workers.paper.weights import FlowStep3DCard, load_flowstep3d

SETTINGS = TrainingSettings(steps=3, batch=2, scorings=3, peak_rate=1e-3)
CARD = FlowStep3DCard(
    points=64,
    neighbours=8,
    radius_m=1.5,
    decay=0.5,
    iterates=4,
    attribution="streets",
    data_license="none",
)


class KilledError(Exception):
    """The end of the process after a step."""


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> list[Pair]:
    folder = tmp_path_factory.mktemp("clouds") / "streets"
    made = clouds_of_streets(folder, streets=1, sensors=["hdl32"], seed=2, columns=360)
    assert made == clouds_of_streets(folder, streets=1, sensors=["hdl32"], seed=3)
    return pairs_of(made)


def test_pairs_are_consecutive_frames_of_one_sample(pairs: list[Pair]) -> None:
    numbers = [(int(each.first.stem), int(each.second.stem)) for each in pairs]
    assert numbers == [(0, 1), (1, 2), (10, 11), (11, 12)]


def test_ego_motion_is_removed_so_that_what_stands_meets_itself() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-30, 30, (400, 3)).astype(np.float32)
    ahead = np.eye(4)
    ahead[0, 3] = 10.0
    seen_later = (points - [10, 0, 0]).astype(np.float32)
    first, second = FlowCloud(points, np.eye(4)).before(FlowCloud(seen_later, ahead))
    np.testing.assert_allclose(first, second, atol=1e-4)
    assert np.abs(first[:, :2]).max() < REACH_M
    assert 300 < len(first) < 400  # what left the reach is left out of both


def test_the_augmentation_keeps_both_clouds_together_but_for_the_further_shift() -> None:
    rng = np.random.default_rng(1)
    cloud = drawn(rng.uniform(-30, 30, (200, 3)).astype(np.float32), 100, rng)
    first, second = augmented(cloud, cloud, replace(DEFAULT, movers=0), rng)
    apart = second - first
    np.testing.assert_allclose(apart, np.broadcast_to(apart[0], apart.shape), atol=1e-4)
    assert 0 < np.abs(apart[0]).max() <= DEFAULT.other_shift_m + 1e-4
    grown = np.linalg.norm(first[0] - first[1]) / np.linalg.norm(cloud[0] - cloud[1])
    assert DEFAULT.scale[0] <= grown <= DEFAULT.scale[1]
    first, second = augmented(cloud, cloud, replace(DEFAULT, other_shift_m=0.0), rng)
    shifted = np.abs(second - first).max(axis=1) > 1e-3
    assert 1 <= shifted.sum() < 50
    assert drawn(cloud, 150, rng).shape == (150, 3)


def test_both_published_settings_are_presets_with_their_schedules() -> None:
    first, second = PUBLISHED["published"], PUBLISHED["published-finetune"]
    assert (first.epochs, first.falls, first.decay) == (80, (50, 70), 1.0)
    assert (second.epochs, second.falls, second.decay) == (30, (5, 15, 25), 0.5)
    assert first.loss.ball_radius_m == 0.75
    assert second.loss.ball_radius_m == 0.5
    assert not first.movers + second.movers
    assert recipe_of("default") is DEFAULT
    found = published_settings(TrainingSettings(seed=7), pairs=33, epochs=80)
    assert (found.steps, found.batch, found.peak_rate, found.seed) == (240, 16, 2e-3, 7)


def test_a_killed_run_goes_on_to_the_same_weights_which_a_stream_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pairs: list[Pair]
) -> None:
    monkeypatch.setattr(loop, "STATE_EVERY_S", 0.0)

    def train(out: Path, *, kill_at: int = -1) -> Progress:
        def on_step(step: int) -> None:
            if step == kill_at:
                raise KilledError

        return train_flow(
            *(pairs[:-1], {"street": pairs[-1:]}, CARD, DEFAULT, SETTINGS),
            out=out,
            state=out.with_suffix(".state"),
            on_step=on_step,
        )

    whole, killed = (
        tmp_path / "whole" / "flowstep3d.safetensors",
        tmp_path / "flowstep3d.safetensors",
    )
    done = train(whole)
    assert done.scores["street loss"] == pytest.approx(-done.best)
    with pytest.raises(KilledError):
        train(killed, kill_at=2)
    torch.manual_seed(99)
    train(killed)
    assert killed.read_bytes() == whole.read_bytes()
    assert load_flowstep3d(killed).card == load_flowstep3d(whole).card
    first, second = (FlowCloud.read(each) for each in (pairs[0].first, pairs[0].second))
    flow = FlowStep3DFlow.load(tmp_path)(first.points_m, second.points_m, np.eye(4))
    assert flow.shape == first.points_m.shape
    assert np.isfinite(flow).all()


def test_the_published_loss_of_a_known_pair_falls(tmp_path: Path, pairs: list[Pair]) -> None:
    settings = replace(SETTINGS, steps=30, scorings=2, batch=1, peak_rate=2e-3)
    recipe = replace(recipe_of("published"), shift_m=0.0, other_shift_m=0.0)
    card = CARD.model_copy(update={"points": 128})
    done = train_flow(
        *(pairs[:1], {"street": pairs[:1]}, card, recipe, settings),
        out=tmp_path / "flowstep3d.safetensors",
    )
    assert done.curve[-1][1] < 0.95 * done.curve[0][1]


def test_a_loss_that_is_not_a_number_keeps_the_last_good_weights(
    tmp_path: Path, pairs: list[Pair]
) -> None:
    out = tmp_path / "flowstep3d.safetensors"
    train_flow(pairs, {}, CARD, DEFAULT, SETTINGS, out=out)
    kept = out.read_bytes()
    with pytest.raises(TrainingDivergedError, match="loss of flowstep3d is not a number"):
        train_flow(
            *(pairs, {}, CARD, DEFAULT, replace(SETTINGS, steps=6, scorings=1, peak_rate=1e30)),
            out=out,
        )
    assert out.read_bytes() == kept


def test_a_pair_without_a_common_reach_is_left_out(tmp_path: Path) -> None:
    points = np.random.default_rng(1).uniform(-20, 20, (400, 3)).astype(np.float32)
    away = np.eye(4)
    away[0, 3] = 500.0
    for number, pose in enumerate((np.eye(4), np.eye(4), away)):
        FlowCloud(points, pose).write(tmp_path / f"{number:06d}.npz")
    found = FlowTask().items_of(sorted(tmp_path.iterdir()))
    assert [each.first.stem for each in found] == ["000000"]
