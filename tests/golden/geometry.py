"""Checks of range images, residual images, pillars and filters."""

import itertools
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from schemas.arrays import Points, Transform
from schemas.camera import CameraCalibration
from tests.golden.conjugation import conjugate
from tests.golden.difference import Difference, near, same
from tests.golden.files import AbsentError, Arrays, arrays, document, number_of, parameters, present
from workers.lidar.fidelity import Form
from workers.lidar.range_image import SensorProfile, image_channels, project
from workers.paper.camera_filter import (
    camera_filter,
    from_flow_space,
    is_ahead_within,
    to_flow_space,
)
from workers.paper.gndnet import GndNet, decorate
from workers.paper.ground_rule import ground_labels
from workers.paper.pillars import Pillars, pillars
from workers.parts.networks import read_known
from workers.points.se3 import inverse
from workers.supervised.paper_residuals import PaperResiduals
from workers.supervised.postprocess import KnnSettings, find_voters
from workers.supervised.residual_image import ResidualSettings, with_residuals
from workers.supervised.weights import WeightsCard

HAS_AVX512 = bool(np._core._multiarray_umath.__cpu_features__.get("AVX512_SKX"))  # type: ignore[attr-defined]
MOVED_PIXELS = 0 if HAS_AVX512 else 4
"""The last bit of arctan2 and arcsin depends on the processor; hidden points move, too."""
ROUNDED_PIXELS = 20
"""Of a residual image: rounding along the chain of poses."""


@cache
def kitti360() -> SensorProfile:
    """Read the range image of the paper's networks from the configuration that ships."""
    card = read_known("salsanext-kitti360")
    if not isinstance(card, WeightsCard):
        raise TypeError(f"a card of salsanext is wanted, not {type(card).__name__}")
    return card.profile


def check_range_projection(folder: Path, file: Path) -> list[Difference]:
    """Compare which point each pixel shows, and the normalised input of the network."""
    del folder
    golden = arrays(file)
    points = golden["points"]
    image = project(points[:, :3], kitti360(), form=Form.PAPER)
    expected = golden["proj_idx"].copy()
    ambiguous = tuple(golden["ambiguous_pixels_row_col"].T.astype(int))
    expected[ambiguous] = image.index[ambiguous]
    alike = image.index == expected
    found = [
        same("proj_idx", image.index, expected, allowed=MOVED_PIXELS),
        near("proj_range", image.range_m[alike], golden["proj_range"][alike], tolerance=1e-5),
    ]
    if "proj_x" in golden:
        moved = (image.column != golden["proj_x"]) | (image.row != golden["proj_y"])
        found += [
            same("proj_x, proj_y", moved, np.zeros_like(moved), allowed=2 * MOVED_PIXELS),
            near("unproj_range", image.point_range_m, golden["unproj_range"], tolerance=1e-5),
            same("proj_mask", image.seen_mask[alike], golden["proj_mask"][alike]),
        ]
        remission = np.where(image.index >= 0, points[image.index, 3], -1)
        shown = alike.copy()
        shown[ambiguous] = False
        found.append(
            near("proj_remission", remission[shown], golden["proj_remission"][shown], tolerance=0.0)
        )
    if "network_input" in golden:
        shown = alike.copy()
        shown[ambiguous] = False
        channels = image_channels(image, points[:, :3], points[:, 3], kitti360())
        wanted = golden["network_input"]
        found.append(near("network_input", channels[:, shown], wanted[:, shown], tolerance=1e-5))
    return found


def check_knn(folder: Path, file: Path) -> list[Difference]:
    """Compare the classes that points get back from the image."""
    golden = arrays(file)
    points = _points(folder, number_of(file))
    classes = golden["argmax_image"]
    image = project(points, kitti360(), form=Form.PAPER)
    voters = find_voters(image, [classes], KnnSettings(form=Form.PAPER))
    looked_up, wanted = voters.look_up(classes), golden["lookup_labels"]
    return [
        same("knn_labels", voters.vote(classes), golden["knn_labels"]),
        same("lookup_labels", looked_up, wanted, allowed=MOVED_PIXELS),
    ]


def check_residuals(folder: Path, file: Path) -> list[Difference]:
    """Stream the frames of the folder and compare every residual image, zero ones too.

    Those of a frame that is absent, or against one, are left out.
    """
    golden = arrays(file)
    found, not_zero = [], 0
    for frame, residuals in _residuals(folder).items():
        for age, residual in residuals.items():
            expected = golden.get(f"k{age}_frame{frame}")
            if expected is None:
                not_zero += int(np.count_nonzero(residual))
                continue
            apart = ~(np.abs(residual - expected) <= 1e-5)
            name, nowhere = f"k{age}_frame{frame}", np.zeros_like(apart)
            found.append(same(name, apart, nowhere, allowed=ROUNDED_PIXELS))
    if not found:
        raise AbsentError("geometry/range_projection_*.npz of two frames")
    return [*found, same("all others are zero", not_zero, 0)]


def check_lmnet_input(folder: Path, file: Path) -> list[Difference]:
    """Compare what LMNet's loader sees: double precision, residuals beside the channels."""
    golden, number = arrays(file), number_of(file)
    points = arrays(folder / "geometry" / f"range_projection_{number:06d}.npz")["points"]
    image = project(points[:, :3], kitti360(), form=Form.PAPER, precision=np.float64)
    channels = image_channels(image, points[:, :3], points[:, 3], kitti360())
    expected = golden["network_input_first7"]
    alike = image.index == golden["proj_idx"]
    moved = (image.column != golden["proj_x"]) | (image.row != golden["proj_y"])
    found = [
        same("proj_idx", image.index, golden["proj_idx"], allowed=MOVED_PIXELS),
        same("proj_x, proj_y", moved, np.zeros_like(moved), allowed=2 * MOVED_PIXELS),
        same("proj_mask", image.seen_mask[alike], golden["proj_mask"][alike]),
        near("channels", channels[:, alike], expected[:5, alike], tolerance=1e-5),
    ]
    if not (folder / "geometry" / "poses.npz").is_file():
        return found
    frames = document(folder / "geometry" / "calibration.json")["frames"]
    known = _residuals(folder)[frames.index(number)]
    nothing, ages = np.zeros(image.index.shape, np.float32), len(ResidualSettings().ages_s)
    residuals = np.stack([known.get(age, nothing) for age in range(1, ages + 1)])
    stacked = with_residuals(image, channels, residuals)
    for age in known:
        if age <= expected.shape[0] - 5:
            apart = ~(np.abs(stacked[4 + age] - expected[4 + age]) <= 1e-5)
            name, allowed = f"residual {age}", ROUNDED_PIXELS
            found.append(same(name, apart, np.zeros_like(apart), allowed=allowed))
    return [*found, same("further residuals are zero", np.count_nonzero(stacked[7:]), 0)]


def check_poses(folder: Path, file: Path) -> list[Difference]:
    """Compare poses of the camera, of the lidar, and from frame to frame."""
    golden = arrays(file)
    lidar = golden["lidar_to_world"]
    camera_from_lidar = calibration_of(folder).extrinsics
    camera = conjugate(camera_from_lidar, lidar)
    back = conjugate(np.linalg.inv(camera_from_lidar).astype(np.float64), golden["cam0_poses"])
    deltas = [inverse(now) @ after for now, after in itertools.pairwise(lidar)]
    return [
        near("cam0_poses", camera, golden["cam0_poses"], tolerance=1e-9),
        near("lidar_to_world", back, lidar, tolerance=1e-9),
        near("lidar_delta", deltas, golden["lidar_delta_next_to_previous"], tolerance=1e-9),
    ]


def check_camera_filter(folder: Path, file: Path) -> list[Difference]:
    """Compare what is left after view, box and ground, and the space of the flow."""
    golden, calibration = arrays(file), calibration_of(folder)
    points = _points(folder, number_of(file))
    left = camera_filter(points, golden["ground_label"], calibration, form=Form.PAPER)
    found = [
        same("index_fov", left.in_view, golden["index_fov"]),
        same("index_fov_35m", left.in_range, golden["index_fov_35m"]),
        same("index_kept", left.kept, golden["index_kept"]),
    ]
    flow_points = to_flow_space(points[left.kept], calibration)
    back = from_flow_space(flow_points, calibration)
    return [
        *found,
        near("points_flow_frame", flow_points, golden["points_flow_frame"], tolerance=5e-6),
        near("points_lidar_frame", back, golden["points_lidar_frame"], tolerance=5e-6),
        same("below_25m", is_ahead_within(golden["points_lidar_frame"]), golden["below_25m"]),
    ]


def check_pillars(folder: Path, file: Path) -> list[Difference]:
    """Compare where pillars stand, their points, and what the encoder makes of them."""
    golden = arrays(file)
    points = arrays(folder / "geometry" / f"range_projection_{number_of(file):06d}.npz")["points"]
    found = pillars(points[:, :3], points[:, 3])
    chosen = golden["selected_pillars"]
    sums = found.points.sum(axis=1, dtype=np.float64)
    return [
        same("coords_zyx", found.coordinates_zyx, golden["coords_zyx"]),
        same("points_in_pillar", found.counts, golden["points_in_pillar"]),
        near("pillar_point_sum", sums, golden["pillar_point_sum"], tolerance=1e-6),
        same("voxels", found.points[chosen], golden["selected_voxels"]),
        *_encoded(folder, found, golden),
    ]


def _encoded(folder: Path, found: Pillars, golden: Arrays) -> list[Difference]:
    """Compare decorated points and, where the network's parameters are there, its encoding."""
    chosen = golden["selected_pillars"]
    taken = (
        torch.from_numpy(found.points[chosen]),
        torch.from_numpy(found.counts[chosen]).long(),
        torch.from_numpy(found.coordinates_zyx[chosen]).long(),
    )
    wanted = golden["selected_decorated_features"]
    compared = [near("decorated features", decorate(*taken).numpy(), wanted, tolerance=2e-5)]
    if (folder / "networks" / "gndnet_parameters.json").is_file():
        net = GndNet()
        filled = parameters(folder, "gndnet")
        net.load_state_dict({key: torch.from_numpy(value) for key, value in filled.items()})
        with torch.inference_mode():
            encoding = net.eval().voxel_feature_extractor(*taken).numpy()
        expected = golden["selected_pillar_encoding"]
        compared.append(near("pillar encoding", encoding, expected, tolerance=2e-5))
    return compared


def check_ground_rule(folder: Path, file: Path) -> list[Difference]:
    """Compare ground labels under a made-up elevation and, where it is there, the network's."""
    golden, number = arrays(file), number_of(file)
    points = _points(folder, number)
    elevations: dict[str, NDArray[Any]] = {"labels_synthetic": golden["elevation_synthetic_yx"]}
    network = folder / "networks" / f"gndnet_{number:06d}.npz"
    if network.is_file():
        drawn: Arrays = arrays(present(network))
        elevations["labels_network_eval"] = drawn["elevation_eval_yx"]
        elevations["labels_network_train_mode"] = drawn["elevation_train_mode_yx"]
    return [
        same(name, ground_labels(points, elevation, form=Form.PAPER), golden[name])
        for name, elevation in elevations.items()
    ]


def calibration_of(folder: Path) -> CameraCalibration:
    """Read the folder's camera."""
    read = document(folder / "geometry" / "calibration.json")
    camera_from_lidar: Transform = np.eye(4)
    camera_from_lidar[:3] = np.reshape(read["Tr"], (3, 4))
    return CameraCalibration.of(
        np.reshape(np.asarray(read["P2"], np.float64), (3, 4)),
        camera_from_lidar,
        width=read["image_width"],
        height=read["image_height"],
    )


def _residuals(folder: Path) -> dict[int, dict[int, NDArray[np.float32]]]:
    """Residual images of every frame of the folder, counted from 0, by age in frames."""
    frames = document(folder / "geometry" / "calibration.json")["frames"]
    poses = arrays(folder / "geometry" / "poses.npz")["lidar_to_world"]
    stream, present_at = PaperResiduals(kitti360()), []
    found = {}
    for frame, (number, pose) in enumerate(zip(frames, poses, strict=True)):
        is_there = (folder / "geometry" / f"range_projection_{number:06d}.npz").is_file()
        points = _points(folder, number) if is_there else np.zeros((0, 3), np.float32)
        residuals = stream(points, pose)
        present_at.append(is_there)
        found[frame] = {
            age: residual
            for age, residual in enumerate(residuals, start=1)
            if is_there and (age > frame or present_at[frame - age])
        }
    return found


def _points(folder: Path, number: int) -> Points:
    read: Points = arrays(folder / "geometry" / f"range_projection_{number:06d}.npz")["points"]
    return read[:, :3]


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "geometry/range_projection_*.npz": check_range_projection,
    "geometry/knn_*.npz": check_knn,
    "geometry/residual_images.npz": check_residuals,
    "geometry/lmnet_input_*.npz": check_lmnet_input,
    "geometry/poses.npz": check_poses,
    "geometry/camera_filter_*.npz": check_camera_filter,
    "geometry/gndnet_pillars_*.npz": check_pillars,
    "geometry/ground_rule_*.npz": check_ground_rule,
}
