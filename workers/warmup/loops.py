"""Warm-up calls of the loops that stages share, so that the compiler need not stay in a worker."""

import numpy as np

from schemas.frame import LidarFrame
from workers.contradiction.neighbour_counts import counts_around
from workers.lidar.pixel_windows import (
    argmax_code,
    look_up,
    majority_code,
    mean_of,
    mixed_windows,
    nearest_in_window,
    padded,
)
from workers.lidar.range_image import SensorProfile, image_channels, project
from workers.lidar.registration_check import extract_structure, register_structures
from workers.points.density import density_clusters, weighted_places
from workers.points.point_kernels import in_centimetres, moved, within_box
from workers.points.points_in_boxes import points_in_boxes

_PROFILE = SensorProfile(name="rehearsal", rows=16, columns=64, fov_up_deg=10, fov_down_deg=-20)


def call_loops(frame: LidarFrame) -> None:
    """Call the loops over range images, static structure, instances and overlays with a frame.

    Read-only arrays, as those of a frame, and writable ones are two types to the compiler: each
    loop is called with the types of its stage.
    """
    image = project(frame.points_m, _PROFILE, valid_mask=frame.valid_mask)
    seen = frame.points_m[image.index[image.index >= 0]]
    placed_m = moved(seen, np.eye(4))
    project(placed_m, _PROFILE, gate_m=(2.0, 100.0))
    structure = extract_structure(placed_m, np.zeros(3))
    if structure is not None:
        register_structures(structure, structure)
    channels = image_channels(image, frame.points_m, frame.intensity, _PROFILE)
    argmax_code(channels.reshape(len(channels), -1))
    codes, flat = np.ones(image.index.shape, np.uint8), image.row * np.int32(64) + image.column
    mixed_windows(codes, image.index, 2, True)
    voters = nearest_in_window(
        padded(image.range_m, image.index, 2, np.float32(np.inf), True),
        image.row,
        image.column,
        image.point_range_m,
        np.flatnonzero(image.row >= 0),
        np.ones((5, 5), np.float32),
        5,
        np.float32(1),
        True,
    )
    look_up(codes, flat, np.uint8(0))
    look_up(image.range_m, flat, np.float32(0))
    majority_code(codes, voters, np.uint8(0))
    mean_of(image.range_m, voters)
    places_m, _, weight = weighted_places(seen, np.float32(0.1))
    density_clusters(places_m, weight, 1.0, 10)
    apart = within_box(frame.points_m, 500.0)
    counts_around(frame.points_m, np.flatnonzero(apart), apart, np.float32(0.4))
    in_centimetres(frame.points_m, frame.valid_mask, np.float32(327), np.int16(0))
    for points_m in (frame.points_m, placed_m):
        points_in_boxes(
            points_m,
            np.zeros(len(points_m), np.float32),
            np.zeros((1, 3)),
            np.eye(3)[None],
            np.ones((1, 3)),
            np.zeros((1, 3)),
            0.3,
            0.2,
        )
