"""Ground methods under evaluation by name, and the floors of any method."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from schemas.frame import LidarFrame, PosedFrame
from schemas.mining import MiningSettings
from schemas.task import GROUND
from workers.errors import UnknownPartError
from workers.lidar.ground import _parameters, _silent_native_stdout
from workers.lidar.sensor_height import estimate_sensor_height
from workers.parts.catalogue import names_of
from workers.parts.protocols import Stream
from workers.parts.registry import build_selfsupervised, build_supervised
from workers.version import files_of

THRESHOLD_M: Final = 0.3
"""Height over the road below the sensor up to which the floor calls a point ground, metres."""

LIBRARY_THRESHOLDS: Final = {"th_dist": 0.125}
"""Threshold that our ground has tighter, metres, as the library has it."""

_GROUND: Final = GROUND.classes.index("ground")


@dataclass(frozen=True, slots=True, eq=False)
class GroundAnswer:
    """Ground of one frame by a method.

    Attributes:
        ground: (N,) points on the ground.
        surface_m: Height of the ground at (x, y), (K,) from (K, 2), sensor space; None where the
            method has no surface of its own, and that of its ground points counts.
    """

    ground: Mask
    surface_m: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None


GroundMethod = Callable[[Iterable[PosedFrame]], Iterator[GroundAnswer]]


def patchwork(frames: Iterable[PosedFrame]) -> Iterator[GroundAnswer]:
    """Yield the ground of Patchwork++ alone, without our guard against car roofs."""
    yield from _per_frame(frames, patchwork_mask)


def patchwork_mask(points_m: Points, *, sensor_height_m: float) -> Mask:
    """Return the ground points of Patchwork++ with its own thresholds, (N,)."""
    import pypatchworkpp

    parameters = pypatchworkpp.Parameters()
    stated = _parameters(sensor_height_m) | LIBRARY_THRESHOLDS
    for name, value in stated.items():
        setattr(parameters, name, value)
    with _silent_native_stdout():
        method = pypatchworkpp.patchworkpp(parameters)
    cloud = np.zeros((len(points_m), 4), np.float32)
    cloud[:, :3] = points_m
    method.estimateGround(cloud)
    mask = np.zeros(len(points_m), np.bool_)
    mask[np.asarray(method.getGroundIndices(), np.intp)] = True
    return mask


def threshold(frames: Iterable[PosedFrame]) -> Iterator[GroundAnswer]:
    """Yield the points up to 0.3 m over the road below the sensor."""
    yield from _per_frame(
        frames, lambda points, sensor_height_m: points[:, 2] < THRESHOLD_M - sensor_height_m
    )


def _per_frame(frames: Iterable[PosedFrame], method: Callable[..., Mask]) -> Iterator[GroundAnswer]:
    height_m = 0.0
    for posed in frames:
        frame = posed.frame
        valid = np.flatnonzero(frame.valid_mask)
        points = frame.points_m[valid]
        height_m = height_m or estimate_sensor_height(points)
        ground = np.zeros(len(frame), np.bool_)
        ground[valid] = method(points, sensor_height_m=height_m)
        yield GroundAnswer(ground)


FLOORS: Final[Mapping[str, GroundMethod]] = {"patchwork++": patchwork, "z-threshold": threshold}


def build(name: str, settings: MiningSettings) -> GroundMethod:
    """Build a ground method by its name.

    Raises:
        UnknownPartError: If it does not exist, or is a stream of another task.
        WeightsUnusableError: If its weights are missing.
    """
    if name in FLOORS:
        return FLOORS[name]
    if name == "gndnet":
        return _gndnet(Path(settings.weights))
    files = files_of(settings)
    if name in names_of("selfsupervised"):
        return _of_stream(build_selfsupervised(name, files), name)
    if name in names_of("supervised"):
        return _of_stream(build_supervised(name, files), name)
    known = ["ground", "salsanext:ground", "recorded:ground", "gndnet", *FLOORS]
    raise UnknownPartError(f"no ground method {name!r}; known: {', '.join(known)}")


def _of_stream(stream: Stream, name: str) -> GroundMethod:
    if stream.task != GROUND:
        raise UnknownPartError(f"stream {name!r} has the task {stream.task.name}, not ground")

    def answers(frames: Iterable[PosedFrame]) -> Iterator[GroundAnswer]:
        for labels in stream(frames):
            yield GroundAnswer(np.asarray(labels.labels == _GROUND))

    return answers


def _gndnet(folder: Path) -> GroundMethod:
    """Load GndNet, whose map of heights is the surface; its own statistics, in single precision."""
    import torch

    from workers.lidar.fidelity import Form
    from workers.paper.ground_rule import GROUND as ON_MAP
    from workers.paper.ground_rule import ground_labels
    from workers.paper.pillars import GNDNET_GRID, pillars
    from workers.paper.weights import load_gndnet

    stored = load_gndnet(folder / "gndnet.safetensors", form=Form.CORRECTED)
    height_m, grid = stored.card.sensor_height_m, GNDNET_GRID

    def elevation(frame: LidarFrame, valid: NDArray[np.intp]) -> NDArray[np.float32]:
        cut = pillars(frame.points_m[valid], frame.intensity[valid], lidar_height_m=height_m)
        with torch.inference_mode():
            answer: NDArray[np.float32] = stored.net(
                torch.from_numpy(cut.points),
                torch.from_numpy(cut.counts.astype(np.int64)),
                torch.from_numpy(cut.coordinates_zyx.astype(np.int64)),
            ).numpy()
        return answer

    def answers(frames: Iterable[PosedFrame]) -> Iterator[GroundAnswer]:
        for posed in frames:
            frame = posed.frame
            valid = np.flatnonzero(frame.valid_mask)
            heights = elevation(frame, valid)
            ground = np.zeros(len(frame), np.bool_)
            ground[valid] = (
                ground_labels(frame.points_m[valid], heights, lidar_height_m=height_m) == ON_MAP
            )

            def surface(
                places: NDArray[np.float64], heights: NDArray[np.float32] = heights
            ) -> NDArray[np.float64]:
                columns = np.floor((places[:, 0] - grid.x_m[0]) / grid.side_m).astype(np.intp)
                rows = np.floor((places[:, 1] - grid.y_m[0]) / grid.side_m).astype(np.intp)
                inside = (columns >= 0) & (columns < grid.shape[1])
                inside &= (rows >= 0) & (rows < grid.shape[0])
                found = np.full(len(places), np.nan)
                found[inside] = heights[rows[inside], columns[inside]] - height_m
                return found

            yield GroundAnswer(ground, surface)

    return answers
