"""Compensation: a sweep in the sensor's space of one instant, as some recorders store it."""

from dataclasses import replace

import numpy as np

from schemas.arrays import NS_PER_S
from workers.lab.simulation.sensor.lidar import GRID_PER_M, Lidar, SimulatedFrame, sensor_poses
from workers.lab.simulation.world.street import Street


def compensate(street: Street, lidar: Lidar, frame: SimulatedFrame) -> SimulatedFrame:
    """Bring each point of a sweep to the sensor's space of the middle of the sweep.

    Only the motion of the sensor is removed, as a recorder does with poses: what moves stays where
    its own beam met it. The frame's time is then the middle, and all points have that time.
    """
    fired_s = np.arange(lidar.columns) * (lidar.period_ns // lidar.columns) / NS_PER_S
    middle_s = frame.time_s + lidar.period_s / 2
    world_from_fired = sensor_poses(street, lidar, frame.time_s + fired_s)
    world_from_middle = sensor_poses(street, lidar, np.array([middle_s]))[0]
    carry = np.linalg.inv(world_from_middle) @ world_from_fired
    carry = carry[frame.offset_ns // (lidar.period_ns // lidar.columns)]
    points_m = np.einsum("nij,nj->ni", carry[:, :3, :3], frame.points_m.astype(np.float64))
    points_m += carry[:, :3, 3]
    return replace(
        frame,
        time_s=middle_s,
        points_m=(np.round(points_m * GRID_PER_M) / GRID_PER_M).astype(np.float32),
        offset_ns=np.zeros(len(frame), np.uint32),
        world_from_sensor=world_from_middle,
    )
