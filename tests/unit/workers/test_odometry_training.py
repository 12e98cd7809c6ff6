"""Training of DeLORA on pairs of scans without labels: normals, losses, a killed run."""

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from torch import nn

from tests import factories
from workers.checkpoints.stored_weights import save
from workers.lab.datasets.frame_files import Pair, pairs_of
from workers.lab.datasets.normal_scans import (
    NormalScan,
    field_of_view,
    patch_normals,
    scans_of_streets,
)
from workers.lab.training import loop, odometry
from workers.lab.training.errors import TrainingDivergedError
from workers.lab.training.known_motion import (
    LEVER_M,
    begin_at_rest,
    drawn_motion,
    known_motion_loss,
    motion_errors,
)
from workers.lab.training.odometry import OdometryLearner, published_settings, train_odometry
from workers.lab.training.odometry_loss import Surface, alignment_loss, identity_loss
from workers.lab.training.run_state import Progress
from workers.lab.training.settings import TrainingSettings
from workers.paper.delora import DeLORA, Motion, matrix
from workers.paper.delora_odometry import DeLORAOdometry, image_of
from workers.paper.weights import DeLORACard, load_delora
from workers.points.se3 import transform

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


def _scans(pair: Pair) -> tuple[Surface, Surface, torch.Tensor]:
    """Both surfaces of a pair, and its true motion."""
    first, second = NormalScan.read(pair.first), NormalScan.read(pair.second)
    surfaces = []
    for scan in (first, second):
        known = scan.normals.any(axis=1)
        surfaces.append(
            Surface(torch.from_numpy(scan.points_m[known]), torch.from_numpy(scan.normals[known]))
        )
    true = np.linalg.inv(first.odom_from_sensor) @ second.odom_from_sensor
    return surfaces[0], surfaces[1], torch.from_numpy(true.astype(np.float32))


@pytest.fixture(scope="module")
def dense(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    """Two scans of a moving car; a coarse scan is its rings, which rest with the sensor."""
    folder = tmp_path_factory.mktemp("dense") / "streets"
    options = {"streets": 1, "columns": 1024, "firings": 1024}
    return pairs_of(scans_of_streets(folder, sensors=["pandar64"], seed=5, **options))[0]  # type: ignore[arg-type]


def test_the_published_loss_of_a_dense_street_is_least_at_the_true_motion(dense: Pair) -> None:
    this, following, true = _scans(dense)
    assert float(true[:3, 3].norm()) > 0.3
    right = alignment_loss(this, following, true)
    for other in (torch.eye(4), torch.linalg.inv(true), true @ true):
        assert float(alignment_loss(this, following, other).total) > 1.1 * float(right.total)


def test_a_moved_scan_lies_on_the_one_before(dense: Pair) -> None:
    first, second = NormalScan.read(dense.first), NormalScan.read(dense.second)
    true = np.linalg.inv(first.odom_from_sensor) @ second.odom_from_sensor
    there = transform(true, second.points_m)
    np.testing.assert_allclose(
        there, second.points_m @ true[:3, :3].T + true[:3, 3], atol=1e-3, rtol=0
    )
    # the rings on the road rest with the sensor, walls do not
    wall = second.normals.any(axis=1) & (np.abs(second.normals[:, 2]) < 0.3)
    tree, known = cKDTree(first.points_m), first.normals
    off = []
    for points in (there[wall], second.points_m[wall], transform(true, there[wall])):
        partner = tree.query(points)[1]
        off.append(np.abs(((points - first.points_m[partner]) * known[partner]).sum(axis=1)).mean())
    assert off[0] < 0.7 * min(off[1:])


@pytest.mark.parametrize(("refinements", "expected_m"), [(0, (0.1, 0.2)), (2, (0.0, 0.0))])
def test_with_refinements_an_error_that_is_the_same_in_both_orders_cancels(
    tmp_path: Path, dense: Pair, refinements: int, expected_m: tuple[float, float]
) -> None:
    net = DeLORA()
    with torch.no_grad():
        for each in net.parameters():
            each.zero_()
        cast(nn.Linear, net.fully_connected_translation[-1]).bias[0] = 0.1
        cast(nn.Linear, net.fully_connected_rotation[-1]).bias[3] = 1.0
    card = CARD.model_copy(update={"refinements": refinements})
    save(tmp_path / "delora.safetensors", net.state_dict(), card)
    found = DeLORAOdometry.load(tmp_path)
    frame = factories.frame(NormalScan.read(dense.first).points_m)
    poses = [posed.odom_from_sensor for posed in found([frame] * 3)]
    np.testing.assert_allclose([each[0, 3] for each in poses], (0, *expected_m), atol=1e-6)
    motion = factories.pose(0.4, 0.1, 0.02)
    ahead = factories.frame(transform(motion, frame.points_m))
    np.testing.assert_array_equal(found.image(frame, motion), found.image(ahead))


def test_the_error_of_a_known_motion_is_metres_and_angles_at_a_distance() -> None:
    angle = np.radians(0.5)
    half = np.sin(angle / 2)
    found = matrix(
        torch.tensor([[0.1, 0.0, -0.2]]),
        torch.tensor([[0.0, 0.0, half, np.cos(angle / 2)]], dtype=torch.float32),
    )
    expected = torch.eye(4)[None].clone()
    expected[0, 0, 3] = 0.3
    shift, turn = motion_errors(found, expected)
    torch.testing.assert_close(shift, torch.tensor([[-0.2, 0.0, -0.2]]))
    torch.testing.assert_close(turn, torch.tensor([[0.0, 0.0, np.sin(angle)]]).float())
    loss = known_motion_loss(Motion(found[:, :3, 3], torch.empty(1, 4), found), expected)
    assert float(loss) == pytest.approx(0.4 + LEVER_M * np.sin(angle), rel=1e-4)


def test_motions_are_drawn_from_a_centimetre_to_a_metre() -> None:
    rng = np.random.default_rng(2)
    drawn = np.stack([drawn_motion(rng) for _ in range(2000)])
    ahead = np.abs(drawn[:, 0, 3])
    assert np.quantile(ahead, 0.2) < 0.05
    assert np.quantile(ahead, 0.95) > 0.5
    assert ahead.mean() > 3 * np.abs(drawn[:, 1, 3]).mean()
    np.testing.assert_allclose(np.linalg.det(drawn[:, :3, :3]), 1, atol=1e-9)


def _change_by(motion_m: float, net: DeLORA, pair: Pair) -> float:
    """Return the change of the features by a motion, in spreads of a feature."""
    first = NormalScan.read(pair.first)
    profile = odometry.profile_of(CARD)
    images = [
        torch.from_numpy(
            image_of(transform(factories.pose(each, 0, 0), first.points_m), profile)[0]
        )
        for each in (0.0, motion_m)
    ]
    with torch.inference_mode():
        still, there = (net.resnet(torch.cat((images[0], each))[None]) for each in images)
    return float((there - still).std() / still.std())


def test_a_network_begins_at_rest_and_sees_motion(pairs: list[Pair]) -> None:
    torch.manual_seed(1)
    drawn = DeLORA().eval()
    net = DeLORA().eval()
    begin_at_rest(net)
    learner = OdometryLearner(pairs, {"street": pairs}, CARD, SETTINGS)
    learner.net.eval()
    _, found = learner.scores()
    assert found["street loss"] == pytest.approx(found["street loss of no motion"], rel=0.5)
    assert _change_by(0.4, net, pairs[0]) > 3 * _change_by(0.4, drawn, pairs[0])


def test_one_batch_of_added_motions_is_learnt_by_heart(pairs: list[Pair]) -> None:
    torch.manual_seed(1)
    settings = replace(SETTINGS, batch=4)
    learner = OdometryLearner(pairs[:1], {}, CARD, settings)
    optimiser = torch.optim.Adam(learner.net.parameters(), lr=1e-4)
    losses = []
    for _ in range(40):
        loss = learner.loss(np.random.default_rng(4))
        optimiser.zero_grad()
        torch.autograd.backward(loss)
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.6 * losses[0]


def test_only_published_random_weights_first_fit_the_identity(pairs: list[Pair]) -> None:
    settings = replace(SETTINGS, published=True, epoch=2)
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


def test_published_weights_are_scored_by_the_published_loss(pairs: list[Pair]) -> None:
    learner = OdometryLearner(pairs, {"street": pairs}, CARD, replace(SETTINGS, published=True))
    learner.net.eval()
    _, found = learner.scores()
    this, following, _ = _scans(pairs[0])
    assert set(found) == {"street loss", "street loss of no motion"}
    still = float(alignment_loss(this, following, torch.eye(4)).total)
    assert 0.2 * still < found["street loss of no motion"] < 5 * still


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
    settings = replace(SETTINGS, steps=40, batch=4, scorings=2, peak_rate=1e-4)
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
    learner_nan = replace(settings, peak_rate=1e37)
    train_odometry(pairs, {}, CARD, settings, out=out)
    with pytest.raises(TrainingDivergedError, match="is not a number"):
        train_odometry(pairs, {}, CARD, learner_nan, out=out)
    assert all(torch.isfinite(each).all() for each in load_delora(out).net.state_dict().values())
