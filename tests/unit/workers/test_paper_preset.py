"""The published chain by one name: what it compares, what it says, and what it needs."""

from collections.abc import Iterator
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from schemas.camera import CameraCalibration
from schemas.frame import LidarFrame
from schemas.labels import Blindness, MotionLabel
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from service.errors import UsageError
from service.settings.config import read_settings
from tests.golden.categories import categories
from workers.checkpoints import stored_weights
from workers.contradiction.agreement import compare
from workers.contradiction.settings import PAPER_INSTANCES
from workers.errors import LogUnusableError, UnknownPartError
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.odometry.odometry import KissOdometry
from workers.paper.paper_chain import PaperChain
from workers.paper.paper_view import NoCameraError
from workers.parts.files import PartFiles
from workers.parts.networks import read_config
from workers.parts.registry import build_odometry, build_parts, build_selfsupervised
from workers.supervised.stream import SHIPPED

CONFIGS = {"gndnet": "gndnet-semantickitti", "flowstep3d": "flowstep3d", "delora": "delora-kitti"}


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The weights that ship, and beside them random ones of every other network."""
    folder = tmp_path_factory.mktemp("weights")
    torch.manual_seed(3)
    for name in ("salsanext", "lmnet"):
        for suffix in (".safetensors", ".json"):
            (folder / f"{name}{suffix}").symlink_to(SHIPPED / f"{name}{suffix}")
    for network, config in CONFIGS.items():
        card = read_config(config, network)
        stored_weights.save(folder / f"{network}.safetensors", card.build().state_dict(), card)
    return folder


def _frames(reference: Path, name: str, *, camera: str) -> Iterator[LidarFrame]:
    logs = reference / "data" / "logs"
    bucket = open_bucket(str(logs))
    (recording,) = [each for each in group_recordings(bucket.list()) if name in each.log_id]
    settings = MiningSettings(bucket=str(logs), artifacts="memory://", camera=camera)
    plan = plan_recording(bucket, recording, settings)
    if plan.refused:
        raise LogUnusableError(plan.refused)
    yield from read_shard(bucket, recording, plan.shards[0], settings).frames()


@pytest.mark.reference
def test_every_stage_of_the_chain_has_the_published_shape_and_codes(
    reference: Path, weights: Path
) -> None:
    chain = PaperChain.load(weights)
    frames = list(islice(_frames(reference, "kitti360-3000", camera="recorded"), 3))
    posed = list(KissOdometry()(frames))
    seen = [chain.view.compared(frame) for frame in frames]
    for frame, of_it in zip(frames, seen, strict=True):
        assert of_it.ground.shape == (len(frame),)
        assert set(np.unique(of_it.ground)) <= {-1, 0, 1}
        assert 2_000 < len(of_it.kept) < len(frame) / 4
        camera_m = of_it.flow_points_m * (-1, -1, 1)
        assert (np.abs(camera_m[:, [0, 2]]) < 35).all()
        assert (of_it.points_m[:, 0] > 0).all()
        assert (of_it.ground[of_it.kept] == 1).all()
    followed = chain.chain(posed[0], seen[0], posed[1], seen[1])
    assert followed.flow_m.shape == seen[0].points_m.shape
    assert np.isfinite(followed.flow_m).all()
    near = seen[0].points_m[followed.near]
    assert (near[:, 0] < 25).all()
    assert followed.found.dynamic.shape == (len(near),)
    assert followed.found.first_cluster.min() >= -1
    assert followed.found.second_cluster.min() >= -2

    labels = list(chain(posed[:2]))
    kept = seen[0].kept[followed.near]
    assert (labels[0].labels[kept] != MotionLabel.UNKNOWN).all()
    assert (np.delete(labels[0].labels, kept) == MotionLabel.UNKNOWN).all()
    assert (labels[1].labels == MotionLabel.UNKNOWN).all()
    assert labels[1].health.blindness is Blindness.NO_PAST
    numbers = categories(compare(np.zeros(len(frames[0]), np.uint8), labels[0].labels))
    assert set(np.unique(numbers[kept])) <= {1, 3}
    assert set(np.unique(np.delete(numbers, kept))) == {0}


@pytest.mark.reference
def test_the_odometry_of_the_paper_composes_rigid_poses(reference: Path, weights: Path) -> None:
    frames = list(islice(_frames(reference, "kitti360-3000", camera=""), 3))
    odometry = build_odometry("delora", PartFiles(weights=str(weights)))
    poses = [posed.odom_from_sensor for posed in odometry(frames)]
    np.testing.assert_array_equal(poses[0], np.eye(4))
    for before, after in pairwise(poses):
        moved = np.linalg.inv(before) @ after
        np.testing.assert_allclose(moved[:3, :3] @ moved[:3, :3].T, np.eye(3), atol=1e-12)
        assert 0 < np.linalg.norm(moved[:3, 3]) < 10


@pytest.mark.reference
def test_a_log_without_a_camera_is_refused_and_takes_one_from_the_settings(
    reference: Path, weights: Path
) -> None:
    with pytest.raises(
        LogUnusableError, match=r"no camera for the camera filter: .*setting camera"
    ):
        next(_frames(reference, "av2-7fab2350", camera="recorded"))
    chain = PaperChain.load(weights)
    (bare,) = islice(_frames(reference, "av2-7fab2350", camera=""), 1)
    with pytest.raises(NoCameraError, match="set camera to `recorded`"):
        chain.view.compared(bare)
    stated = CameraCalibration.of(
        np.array([[700, 0, 600, 0], [0, 700, 200, 0], [0, 0, 1, 0]], np.float64),
        np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], np.float64),
        width=1200,
        height=400,
    )
    (frame,) = islice(
        _frames(reference, "av2-7fab2350", camera=stated.model_dump_json(exclude_none=True)), 1
    )
    assert frame.camera == stated
    assert len(chain.view.compared(frame).kept) > 100


def test_the_preset_names_parts_and_whatever_is_written_wins(tmp_path: Path) -> None:
    settings = read_settings(preset="paper", weights=str(tmp_path)).settings
    assert settings.selfsupervised == "paper"
    assert settings.supervised == "salsanext-lmnet:published"
    assert settings.camera == "recorded"
    assert settings.mining().instances == "paper"
    read = read_settings(preset="paper", odometry="delora", camera="")
    assert read.settings.odometry == "delora"
    assert read.settings.camera == ""
    assert read.written["instances"].origin == "preset paper"
    with pytest.raises(UsageError, match="preset"):
        read_settings(preset="published")


def test_a_calibration_that_is_none_is_refused_with_its_place(tmp_path: Path) -> None:
    absent = tmp_path / "camera.json"
    with pytest.raises(UsageError, match=r"camera: .*No such file.*camera.json"):
        read_settings(camera=str(absent)).settings.mining()
    absent.write_text('{"width": 10}')
    with pytest.raises(UsageError, match=r"camera: pixel_from_camera: Field required"):
        read_settings(camera=str(absent)).settings.mining()


def test_the_parts_of_the_paper_need_weights_that_do_not_ship(weights: Path) -> None:
    with pytest.raises(UnknownPartError, match="stream paper needs weights that do not ship"):
        build_selfsupervised("paper")
    with pytest.raises(UnknownPartError, match="odometry delora needs weights"):
        build_odometry("delora")
    with pytest.raises(UnknownPartError, match="lacks salsanext, lmnet, gndnet, flowstep3d, which"):
        build_parts(
            odometry="kiss-icp",
            supervised="salsanext-lmnet:published",
            selfsupervised="paper",
            files=PartFiles(weights=str(SHIPPED.parent)),
        )
    parts = build_parts(
        odometry="delora",
        supervised="salsanext-lmnet:published",
        selfsupervised="paper",
        instances="paper",
        files=PartFiles(weights=str(weights)),
    )
    assert parts.instances == PAPER_INSTANCES
    assert parts.selfsupervised.version.startswith("paper@")
    assert parts.odometry.version.startswith("delora@")
