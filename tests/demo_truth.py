"""A simulated log of one frame with three things, and the truth of its points, for the demo."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from schemas.labels import Agreement
from schemas.overlay import Overlay
from tests.factories import BEGIN_NS
from tests.overlays import labels_of_points

TRACKS = np.repeat(np.array([4, 5, -1], dtype=np.int16), 10)
"""Truth: ten points of object 4, ten of object 5, ten of nobody."""

PLACES_M = np.repeat(np.array([[9.0, 0.0, 0.0], [40.0, 0.0, 0.0], [0.0, 9.0, 0.0]]), 10, axis=0)
SHIFT_M = np.array([100.0, 0.0, 0.0])


def write_truth(folder: Path, *, stamps_ns: Sequence[int]) -> None:
    """Write the truth of these frames: what is asked of that of a simulated log."""
    frames = [f'{{"index": {n}, "header_stamp": {stamp}}}' for n, stamp in enumerate(stamps_ns)]
    (folder / "frames.json").write_text(f'{{"frames": [{", ".join(frames)}]}}')
    poses = np.repeat(np.eye(4)[None], len(stamps_ns), axis=0)
    poses[:, :3, 3] = SHIFT_M
    np.savez(
        folder / "poses.npz",
        stamp_ns=np.array(stamps_ns, dtype=np.int64),
        world_from_lidar_at_stamp=poses,
    )
    motion = np.where(TRACKS == 5, 2, 1).astype(np.uint8)
    for number in range(len(stamps_ns)):
        np.savez(folder / f"{number:06d}.npz", track=TRACKS, motion=motion)


def one_thing(
    scene_id: str, *, stamp_ns: int = BEGIN_NS + 1_000_000_000, on: Sequence[int] = (4,)
) -> Overlay:
    """The overlay of one frame in which all points of these objects are the first track."""
    points = len(TRACKS)
    mine = np.isin(TRACKS, on)
    return Overlay(
        scene_id=scene_id,
        stamps_ns=np.array([stamp_ns], dtype=np.int64),
        offsets=np.array([0, points], dtype=np.int64),
        points_cm=(100 * PLACES_M).astype(np.int16),
        **labels_of_points(np.zeros(points, np.uint8)),
        ground_mask=np.zeros(points, np.bool_),
        class_id=np.full(points, -1, np.int16),
        class_names=(),
        semantic_confidence=np.zeros(points, np.uint8),
        predictive_confidence=np.zeros(points, np.uint8),
        instance_index=np.where(mine, 0, -1).astype(np.int32),
        odom_from_sensor=np.eye(4)[None],
        instance_frame=np.zeros(1, np.int32),
        instance_kind=np.full(1, Agreement.ONLY_PREDICTIVE_DYNAMIC, np.uint8),
        instance_track=np.zeros(1, np.int32),
        instance_boxes=np.zeros((1, 7), np.float32),
    )
