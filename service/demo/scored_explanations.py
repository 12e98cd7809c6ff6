"""Evaluation of first reasons against truth: is the track of the reason a planted failure?"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from schemas.arrays import Mask, Points
from schemas.overlay import Overlay

if TYPE_CHECKING:
    from workers.lab.simulation.faults.fault_truth import FailureRow


class PlantedPoints:
    """Truth of one simulated log: the points of each planted failure."""

    def __init__(self, folder: Path) -> None:
        """Keep the folder of the log's truth; frames are read on demand."""
        self._folder = folder
        listed = json.loads((folder / "frames.json").read_text())["frames"]
        self._number = {row["header_stamp"]: row["index"] for row in listed}
        with np.load(folder / "poses.npz") as poses:
            stamps, known = poses["stamp_ns"], poses["world_from_lidar_at_stamp"]
        self._world_from_sensor = dict(zip(stamps.tolist(), known, strict=True))

    def first_reason_names(
        self, overlay: Overlay, failures: Sequence["FailureRow"], *, track_id: int = 0
    ) -> bool:
        """Return true if most points of a contradicting track belong to an active failure.

        Args:
            overlay: Overlay of the scene.
            failures: Failures planted into its log.
            track_id: The track; the first reason is about the first one.
        """
        planted = points = 0
        for instance in np.flatnonzero(overlay.instance_track == track_id).tolist():
            frame = int(overlay.instance_frame[instance])
            stamp_ns = int(overlay.stamps_ns[frame])
            due = [each for each in failures if each.start_ns <= stamp_ns < each.end_ns]
            if not due:
                continue
            mine = overlay.instance_index[overlay.points_of(frame)] == instance
            points_m = overlay.points_m(frame)
            is_planted = self._of_any(due, stamp_ns, points_m)
            planted += int((mine & is_planted).sum())
            points += int(mine.sum())
        return 2 * planted > points

    def _of_any(self, due: Sequence["FailureRow"], stamp_ns: int, points_m: Points) -> Mask:
        from workers.lab.evaluation.truth.truth import TRUTH_DYNAMIC
        from workers.lab.simulation.faults.faults import GHOST_RADIUS_M
        from workers.lab.simulation.faults.plan import FailureKind

        with np.load(self._folder / f"{self._number[stamp_ns]:06d}.npz") as truth:
            track, motion = truth["track"], truth["motion"]
        found = np.zeros(len(points_m), dtype=np.bool_)
        for each in due:
            if each.kind is FailureKind.RANGE_LIMIT:
                moves = motion == TRUTH_DYNAMIC
                found |= moves & (np.hypot(points_m[:, 0], points_m[:, 1]) > each.range_m)
            elif each.place_m is not None:
                pose = self._world_from_sensor[stamp_ns]
                in_sensor = (np.array(each.place_m) - pose[:3, 3]) @ pose[:3, :3]
                near = np.linalg.norm(points_m - in_sensor, axis=1) < GHOST_RADIUS_M
                found |= near & (track < 0)
            else:
                partners = [one for one in (each.track, each.other_track) if one >= 0]
                found |= np.isin(track, partners)
        return found
