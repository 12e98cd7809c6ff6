"""True scene flow: the position of each point one frame later, in the sensor space of that time."""

import numba
import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from workers.lab.simulation.sensor.lidar import Lidar, SimulatedFrame, sensor_poses
from workers.lab.simulation.world.attitude import rotations
from workers.lab.simulation.world.street import Street

_PER_M = 256
"""Steps of the flow per metre: 1/256 m is the resolution of float16 at the speed of a car."""


def flow_of(street: Street, lidar: Lidar, frame: SimulatedFrame) -> NDArray[np.float16]:
    """Compute the scene flow of each point over one period of the lidar.

    Returns:
        (N, 3) position in sensor space one period after the firing of the point, minus its position
        at the firing. Ego-motion is included. Points of an actor move rigidly with its body.
    """
    column_ns = lidar.period_ns // lidar.columns
    column = (frame.offset_ns // column_ns).astype(np.int64)
    time_s = frame.time_s + np.arange(lidar.columns) * column_ns / NS_PER_S
    now = sensor_poses(street, lidar, time_s)
    then = sensor_poses(street, lidar, time_s + lidar.period_s)
    then_from_world = np.linalg.inv(then).astype(np.float64, copy=False)
    relative = then_from_world @ now
    points = frame.points_m.astype(np.float64)
    moved = _carried_by_column(relative, column, points)
    mine = np.flatnonzero(np.isin(frame.track, street.moving_index))
    if len(mine):
        tracks, which = np.unique(frame.track[mine], return_inverse=True)
        begin, end = frame.time_s, frame.time_s + lidar.period_s
        start, middle, last = (
            street.actor_bodies(at, tracks.astype(np.int64))[which]
            for at in (begin, end, end + lidar.period_s)
        )
        share = (frame.offset_ns[mine] / lidar.period_ns)[:, None]
        first = _pose(start + share * (middle - start))
        second = _pose(middle + share * (last - middle))
        world = _carried(now[column[mine]], points[mine])
        body = np.einsum("nji,nj->ni", first[:, :3, :3], world - first[:, :3, 3])
        moved[mine] = _carried(then_from_world[column[mine]], _carried(second, body))
    return (np.round((moved - points) * _PER_M) / _PER_M).astype(np.float16)


@numba.njit(cache=True)
def _carried_by_column(
    transforms: NDArray[np.float64], column: NDArray[np.int64], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    moved = np.empty_like(points)
    for n in range(len(points)):
        by = transforms[column[n]]
        for k in range(3):
            moved[n, k] = (
                by[k, 0] * points[n, 0]
                + by[k, 1] * points[n, 1]
                + by[k, 2] * points[n, 2]
                + by[k, 3]
            )
    return moved


def _carried(transforms: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    turned = np.einsum("nij,nj->ni", transforms[:, :3, :3], points)
    result: NDArray[np.float64] = turned + transforms[:, :3, 3]
    return result


def _pose(bodies: NDArray[np.float64]) -> NDArray[np.float64]:
    poses = np.zeros((len(bodies), 4, 4))
    poses[:, :3, :3] = rotations(bodies[:, 3], bodies[:, 4], bodies[:, 5])
    poses[:, :3, 3] = bodies[:, :3]
    poses[:, 3, 3] = 1.0
    return poses
