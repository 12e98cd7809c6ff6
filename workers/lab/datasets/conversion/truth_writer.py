"""Truth writer of a converted log: the folder of `deploy/TRUTH.md`, frame by frame."""

import csv
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np

from schemas.arrays import Transform
from workers.lab.datasets.conversion.boxes import CREEPING_M_PER_S, MOVING_M_PER_S, TrackRow
from workers.lab.datasets.conversion.source import ClassRow, SourceFrame, SourceLog
from workers.lab.simulation.output.truth import write_arrays

ABOUT_FILE: Final = "dataset.json"
"""Data set, licence, attribution and notes of a truth folder that was converted."""

_COLUMNS: Final = (
    *("frame", "track_id", "uuid", "class", "movable_class", "x", "y", "z"),
    *("length", "width", "height", "yaw", "vx", "vy", "vz", "speed"),
    *("moving", "creeping", "points_inside"),
)


class TruthWriter:
    """Writes the truth of one log; the tables grow in files, so that memory does not.

    Args:
        folder: Folder to write, new.
        log: The log.
        about: What `dataset.json` states.
    """

    def __init__(self, folder: Path, log: SourceLog, about: Mapping[str, Any]) -> None:
        self._folder, self._log, self._about = folder, log, about
        self._index = self._dynamic = self._points = self._judged = 0
        self._stamps: list[int] = []
        self._poses: list[Transform] = []
        folder.mkdir(parents=True, exist_ok=True)
        self._listing = (folder / "frames.json").open("w")
        self._listing.write(f'{{"log": {json.dumps(log.key + ".mcap")}, "frames": [')
        self._tracks = (folder / "tracks.csv").open("w", newline="")
        self._table = csv.writer(self._tracks, lineterminator="\n")
        self._table.writerow(_COLUMNS)

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the files; the folder is complete after `finish` alone."""
        self._listing.close()
        self._tracks.close()

    def add(self, frame: SourceFrame, data: bytes) -> None:
        """Write the truth of the next frame; `data` are the packed points of its cloud."""
        if frame.truth:
            write_arrays(self._folder / f"{self._index:06d}.npz", **frame.truth)
            self._judged += 1
        dynamic = 0
        if "motion" in frame.truth:
            dynamic = int(np.count_nonzero(frame.truth["motion"] == 2))
        row = {
            "index": self._index,
            "topic": self._log.topic,
            "log_time": frame.stamp_ns,
            "header_stamp": frame.stamp_ns,
            "points": len(frame.rows),
            "dynamic": dynamic,
            "data_crc32": zlib.crc32(data),
        }
        self._listing.write(("," if self._index else "") + "\n" + json.dumps(row))
        self._table.writerows(_cells(self._index, track) for track in frame.tracks)
        if frame.world_from_sensor is not None:
            self._stamps.append(frame.stamp_ns)
            self._poses.append(frame.world_from_sensor)
        self._index += 1
        self._points += len(frame.rows)
        self._dynamic += dynamic

    def finish(self) -> None:
        """Write the tables of the whole log."""
        counts = {
            "frames": self._index,
            "points": self._points,
            "dynamic_points": self._dynamic,
            "frames_with_labels": self._judged,
        }
        self._listing.write(f'\n], "counts": {json.dumps(counts)}}}\n')
        self._listing.close()
        self._tracks.close()
        if self._poses:
            np.savez_compressed(
                self._folder / "poses.npz",
                stamp_ns=np.array(self._stamps, np.int64),
                world_from_lidar_at_stamp=np.array(self._poses),
            )
        if self._log.classes:
            listed = {"classes": [_described(each) for each in self._log.classes]}
            (self._folder / "classes.json").write_text(json.dumps(listed, indent=1) + "\n")
        about = json.dumps({**self._about, "notes": list(self._log.notes)}, indent=1) + "\n"
        (self._folder / ABOUT_FILE).write_text(about)


def _described(row: ClassRow) -> dict[str, Any]:
    group = "movable" if row.movable else "ignore" if row.noise else "static"
    return {
        "id": row.class_id,
        "name": row.name,
        "group": group,
        "ground": int(row.is_ground),
        "semantickitti19": row.semantickitti19,
    }


def _cells(frame: int, track: TrackRow) -> list[Any]:
    speed = track.speed
    velocity = ("", "", "") if track.velocity is None else map(_rounded, track.velocity)
    moving = creeping = ""
    if speed is not None and track.movable:
        moving = str(int(speed > MOVING_M_PER_S))
        creeping = str(int(CREEPING_M_PER_S < speed <= MOVING_M_PER_S))
    return [
        *(frame, track.track, track.uuid, track.name, int(track.movable)),
        *map(_rounded, (track.x, track.y, track.z)),
        *map(_rounded, (track.length, track.width, track.height)),
        "" if track.yaw is None else round(track.yaw, 6),
        *velocity,
        *(_rounded(speed), moving, creeping),
        "" if track.points_inside is None else track.points_inside,
    ]


def _rounded(value: float | None) -> float | str:
    return "" if value is None else round(value, 4)
