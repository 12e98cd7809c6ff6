"""Training of DeLORA on pairs of scans without labels: normals, losses, a killed run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests import factories
from workers.lab.datasets.frame_files import Pair, pairs_of
from workers.lab.datasets.normal_scans import (
    NormalScan,
    field_of_view,
    patch_normals,
    scans_of_streets,
)
from workers.lab.training import loop
from workers.lab.training.errors import TrainingDivergedError
from workers.lab.training.odometry import (
    OdometryLearner,
    drawn_motion,
    moved,
    published_settings,
    train_odometry,
)
from workers.lab.training.odometry_loss import Surface, alignment_loss, identity_loss
from workers.lab.training.run_state import Progress
from workers.lab.training.settings import TrainingSettings
from workers.paper.delora_odometry import DeLORAOdometry
from workers.paper.weights import DeLORACard, load_delora

SETTINGS = TrainingSettings(steps=3, batch=1, scorings=3, peak_rate=1e-4)
CARD = DeLORACard(
    rows=16,
    columns=64,
    fov_up_deg=11.0,
    fov_down_deg=-31.0,
    attribution="streets",
    data_license="none",
)


class KilledError(Exception):
    """The end of the process after a step."""


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> list[Pair]:
    folder = tmp_path_factory.mktemp("scans") / "streets"
    options = {"streets": 1, "columns": 360, "firings": 360}
    made = scans_of_streets(folder, sensors=["hdl32"], seed=2, **options)  # type: ignore[arg-type]
    assert made == scans_of_streets(folder, sensors=["hdl32"], seed=3, **options)  # type: ignore[arg-type]
    return pairs_of(made)


def test_the_normals_of_a_wall_and_of_the_ground_face_the_sensor() -> None:
    rows, columns = 16, 90
    azimuth = np.radians(180 - 360 * (np.arange(columns) + 0.5) / columns)
    elevation = np.radians(np.linspace(-5, -20, rows))
    flat = np.stack(
        [
            np.broadcast_to(np.cos(azimuth), (rows, columns)),
            np.broadcast_to(np.sin(azimuth), (rows, columns)),
            np.broadcast_to(np.tan(elevation)[:, None], (rows, columns)),
        ],
        axis=2,
    )
    ground = (flat * (-1.8 / flat[..., 2:])).astype(np.float32)[-6:]
    normals = patch_normals(ground, np.ones(ground.shape[:2], np.bool_))
    found = normals[normals.any(axis=2)]
    assert len(found) > 100
    np.testing.assert_allclose(found, np.broadcast_to([0, 0, 1], found.shape), atol=1e-3)
    ahead = np.abs(azimuth) < 0.5
    wall = (flat * (6 / flat[..., :1])).astype(np.float32)
    normals = patch_normals(wall, np.broadcast_to(ahead, (rows, columns)))
    found = normals[normals.any(axis=2)]
    assert len(found) > 50
    np.testing.assert_allclose(found, np.broadcast_to([-1, 0, 0], found.shape), atol=1e-3)
    nothing = patch_normals(wall, np.zeros((rows, columns), np.bool_))
    assert not nothing.any()


def test_the_field_of_view_leaves_stray_points_out() -> None:
    elevation = np.radians(np.append(np.linspace(-20, 5, 9999), 80))
    points = np.stack([np.cos(elevation), 0 * elevation, np.sin(elevation)], axis=1)
    up, down = field_of_view(points.astype(np.float32))
    assert up == pytest.approx(5, abs=0.1)
    assert down == pytest.approx(-20, abs=0.1)


def _corner() -> Surface:
    """Ground and two walls."""
    rng = np.random.default_rng(4)
    flat = rng.uniform(-10, 10, (3, 400, 3)).astype(np.float32)
    normals = np.zeros_like(flat)
    for axis, level in enumerate((10.0, 10.0, -2.0)):
        flat[axis, :, axis] = level
        normals[axis, :, axis] = -np.sign(level)
    return Surface(torch.from_numpy(flat.reshape(-1, 3)), torch.from_numpy(normals.reshape(-1, 3)))


def test_the_losses_vanish_for_the_true_motion_and_lead_to_it() -> None:
    here = _corner()
    moved_by = torch.from_numpy(factories.pose(0.3, -0.1, 0.02).astype(np.float32))
    back = torch.linalg.inv(moved_by)
    later = Surface(here.points_m @ back[:3, :3].T + back[:3, 3], here.normals @ back[:3, :3].T)
    right = alignment_loss(here, later, moved_by)
    assert float(right.total) < 1e-6
    guess = torch.eye(4, requires_grad=True)
    wrong = alignment_loss(here, later, guess)
    assert wrong.plane_to_plane.item() > 1e-4
    # a third of the points each is 0.3 and 0.1 m off its wall, the others are on theirs
    assert wrong.point_to_plane.item() == pytest.approx((0.09 + 0.01) / 3, rel=0.4)
    (gradient,) = torch.autograd.grad(wrong.total, guess)
    assert gradient[0, 3] < 0 < gradient[1, 3]
    assert float(identity_loss(torch.eye(4)[None])) == 0.0
    assert float(identity_loss(moved_by[None])) > 0


def test_a_further_motion_moves_points_and_turns_normals(pairs: list[Pair]) -> None:
    scan = NormalScan.read(pairs[0].first)
    further = drawn_motion(np.random.default_rng(2))
    found = moved(scan, further)
    expected = scan.points_m @ further[:3, :3].T + further[:3, 3]
    np.testing.assert_allclose(found.points_m, expected, atol=1e-4)
    lengths = np.linalg.norm(found.normals[found.normals.any(axis=1)], axis=1)
    np.testing.assert_allclose(lengths, 1, atol=1e-4)


def test_random_weights_first_fit_the_identity_and_given_ones_do_not(pairs: list[Pair]) -> None:
    settings = replace(SETTINGS, steps=40)
    torch.manual_seed(1)
    learner = OdometryLearner(pairs, {}, CARD, settings)
    losses = []
    for step in (2, 3):
        learner.start_step(step)
        losses.append(learner.loss(np.random.default_rng(5)).item())
    assert losses[0] != losses[1]
    going_on = OdometryLearner(pairs, {}, CARD, settings, learner.net.state_dict())
    going_on.start_step(1)
    assert going_on.loss(np.random.default_rng(5)).item() == losses[1]


def test_the_published_schedule_follows_from_the_pairs() -> None:
    found = published_settings(TrainingSettings(seed=7), pairs=33, epochs=2)
    assert (found.steps, found.epoch, found.batch, found.peak_rate) == (66, 33, 1, 1e-5)


def test_a_killed_run_goes_on_to_the_same_weights_which_odometry_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pairs: list[Pair]
) -> None:
    monkeypatch.setattr(loop, "STATE_EVERY_S", 0.0)

    def train(out: Path, *, kill_at: int = -1) -> Progress:
        def on_step(step: int) -> None:
            if step == kill_at:
                raise KilledError

        return train_odometry(
            *(pairs[:-1], {"street": pairs[-1:]}, CARD, SETTINGS),
            out=out,
            state=out.with_suffix(".state"),
            on_step=on_step,
        )

    whole, killed = tmp_path / "whole" / "delora.safetensors", tmp_path / "delora.safetensors"
    done = train(whole)
    assert done.scores["street loss"] == pytest.approx(-done.best)
    with pytest.raises(KilledError):
        train(killed, kill_at=2)
    torch.manual_seed(99)
    train(killed)
    assert killed.read_bytes() == whole.read_bytes()
    assert load_delora(killed).card == load_delora(whole).card
    frame = factories.frame(NormalScan.read(pairs[0].first).points_m)
    poses = [posed.odom_from_sensor for posed in DeLORAOdometry.load(tmp_path)([frame, frame])]
    assert np.isfinite(poses).all()


def test_the_loss_of_a_known_street_falls(tmp_path: Path, pairs: list[Pair]) -> None:
    settings = replace(SETTINGS, steps=40, scorings=2, peak_rate=5e-4)
    done = train_odometry(
        *(pairs[:1], {"street": pairs[:1]}, CARD, settings), out=tmp_path / "delora.safetensors"
    )
    scores = [score for _, _, score in done.curve]
    assert scores[-1] > scores[0]


def test_a_loss_that_is_not_a_number_keeps_the_last_good_weights(
    tmp_path: Path, pairs: list[Pair]
) -> None:
    out = tmp_path / "delora.safetensors"
    settings = replace(SETTINGS, steps=6, scorings=6, peak_rate=1e-4)
    learner_nan = replace(settings, peak_rate=1e30)
    train_odometry(pairs, {}, CARD, settings, out=out)
    with pytest.raises(TrainingDivergedError, match="is not a number"):
        train_odometry(pairs, {}, CARD, learner_nan, out=out)
    assert all(torch.isfinite(each).all() for each in load_delora(out).net.state_dict().values())
