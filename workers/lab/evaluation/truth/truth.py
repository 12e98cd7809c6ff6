"""Ground truth of each point of a log, per lidar message."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask
from schemas.errors import PermanentError
from schemas.frame import LidarFrame
from schemas.transport.bucket import Bucket
from schemas.transport.recordings import EXTENSION, group_recordings
from schemas.work import Recording
from workers.lab.evaluation.truth.class_table import (
    COARSE,
    SEMANTIC_KITTI,
    coarse_of_ids,
    coarse_of_names,
)
from workers.lab.evaluation.truth.objects import Objects, TrueObject, objects_in, rotations_in

TRUTH_UNKNOWN: Final = 0
TRUTH_STATIC: Final = 1
TRUTH_DYNAMIC: Final = 2

TRUTH_NO_GROUND_LABEL: Final = 255
"""Code of a point in the array `ground` that is not judged."""

GROUND_CLASSES: Final = ("road", "sidewalk", "other_ground")


class TruthUnusableError(PermanentError):
    """Truth does not fit its log, or there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameTruth:
    """The truth of one frame, in the order of its points.

    Attributes:
        number: Number of the frame among the lidar messages of its log, from 0.
        motion: (N,) `TRUTH_UNKNOWN`, `TRUTH_STATIC` or `TRUTH_DYNAMIC`.
        track: (N,) id of the object a point belongs to, -1 none; None where truth has no tracks.
        objects: Class, size and speed of the objects, by id.
        world_from_sensor: (3, 3) true attitude of the sensor; None where not known.
    """

    number: int
    motion: NDArray[np.uint8]
    track: NDArray[np.int16] | None
    objects: Objects = field(default_factory=dict)
    world_from_sensor: NDArray[np.float64] | None = None

    def of_points(self, kept: Mask) -> "FrameTruth":
        """Return the truth of the points where `kept`, (N,), is true."""
        track = None if self.track is None else self.track[kept]
        return replace(self, motion=self.motion[kept], track=track)


@dataclass(frozen=True, slots=True)
class _Entry:
    path: Path
    stamp_ns: int | None
    log_time_ns: int | None


@dataclass(frozen=True, slots=True, eq=False)
class LogTruth:
    """The truth of one log: a folder for each part, `NNNNNN.npz` for each message of the lidar.

    `deploy/TRUTH.md` defines the format. Frames are matched by their stamps where `frames.json`
    lists them, so that an unreadable cloud causes no offset; else by their order.

    Attributes:
        topic: Lidar topic of the truth; empty where the truth does not name it.
    """

    topic: str
    _root: Path
    _entries: tuple[_Entry, ...]
    _number_of_stamp: Mapping[int, int]
    _objects: Mapping[Path, Mapping[int, Mapping[int, TrueObject]]]
    _rotations: Mapping[int, NDArray[np.float64]]
    _partial: bool = False

    @classmethod
    def beside(cls, recording: Recording, truth: Path, *, needs_labels: bool = True) -> Self | None:
        """Find the truth of a log; None where there is none.

        Args:
            recording: The log; truth of its part `x/y.mcap` is in `truth/x/y`.
            truth: Folder of the truth of the whole bucket.
            needs_labels: False to find truth of poses alone too.
        """
        entries: list[_Entry] = []
        topics: list[str] = []
        folders = [truth / part.key.removesuffix(EXTENSION) for part in recording.parts]
        if not any(folder.is_dir() for folder in folders):
            folders = [truth / recording.log_id]
        for folder in folders:
            for entry, topic in _entries_of(folder):
                entries.append(entry)
                topics.append(topic)
        if not entries or (needs_labels and not any(each.path.is_file() for each in entries)):
            return None
        stamps: dict[int, int] = {}
        for number, entry in enumerate(entries):
            for time_ns in (entry.stamp_ns, entry.log_time_ns):
                if time_ns is not None:
                    stamps.setdefault(time_ns, number)
        return cls(
            topics[0],
            truth,
            tuple(entries),
            stamps,
            {folder: objects_in(folder) for folder in folders},
            {stamp: pose for folder in folders for stamp, pose in rotations_in(folder).items()},
            any(_is_partial(folder) for folder in folders),
        )

    def __len__(self) -> int:
        """Count the frames of the truth, including those without labels."""
        return len(self._entries)

    def number_of(self, frame: LidarFrame, *, position: int) -> int:
        """Return the message number of a frame.

        Args:
            frame: The frame with all its recorded points.
            position: Number of frames of the log read before it.

        Returns:
            Its number; of a frame that a partial truth does not list, one beyond all numbers.

        Raises:
            TruthUnusableError: If the truth lists the stamps of all frames, but not this one.
        """
        if not self._number_of_stamp:
            return position
        try:
            return self._number_of_stamp[frame.stamp_ns]
        except KeyError:
            if self._partial:
                return len(self._entries)
            raise TruthUnusableError(
                f"truth knows no frame of stamp {frame.stamp_ns} ({frame.log_id}, frame "
                f"{position}); is it the truth of another log?"
            ) from None

    def name_of(self, number: int) -> str:
        """Return the name of a frame in the truth: `x/y/NNNNNN` for a part `x/y.mcap`."""
        return self._entries[number].path.relative_to(self._root).with_suffix("").as_posix()

    def of(self, frame: LidarFrame, *, number: int) -> FrameTruth | None:
        """Read the truth of one frame; None without motion labels.

        Raises:
            TruthUnusableError: If it labels a different number of points.
        """
        path, arrays = self._arrays_of(frame, number, ("motion", "track"))
        if "motion" not in arrays:
            return None
        track = arrays.get("track")
        return FrameTruth(
            number,
            np.asarray(arrays["motion"], dtype=np.uint8),
            None if track is None else np.asarray(track, dtype=np.int16),
            self._objects[path.parent].get(int(path.stem), {}),
            self._rotations.get(frame.stamp_ns),
        )

    def classes_of(self, frame: LidarFrame, *, number: int) -> NDArray[np.uint8] | None:
        """Read the coarse class of each point (`class_table`); 0 where truth has none.

        Returns:
            (N,) classes; None where the truth of this frame has none, or no table of their ids.

        Raises:
            TruthUnusableError: If it labels a different number of points.
        """
        path, arrays = self._arrays_of(frame, number, ("semantic19", "semantic"))
        if "semantic19" in arrays:
            table, ids = coarse_of_names(SEMANTIC_KITTI), arrays["semantic19"]
        elif "semantic" in arrays and (of_ids := coarse_of_ids(path.parent)) is not None:
            table, ids = of_ids, arrays["semantic"]
        else:
            return None
        classes: NDArray[np.uint8] = table[ids]
        return classes

    def ground_of(self, frame: LidarFrame, *, number: int) -> NDArray[np.uint8] | None:
        """Read which points are ground: 1, 0 not, 255 not judged; by class where not stated.

        Returns:
            (N,) codes; None where the truth of this frame has neither.

        Raises:
            TruthUnusableError: If it labels a different number of points.
        """
        _, arrays = self._arrays_of(frame, number, ("ground",))
        if "ground" in arrays:
            stated: NDArray[np.uint8] = np.asarray(arrays["ground"], dtype=np.uint8)
            return stated
        classes = self.classes_of(frame, number=number)
        if classes is None:
            return None
        ground = np.isin(classes, [COARSE.index(name) for name in GROUND_CLASSES])
        codes = ground.astype(np.uint8)
        codes[classes == 0] = TRUTH_NO_GROUND_LABEL
        return codes if ground.any() else None

    def flow_of(self, frame: LidarFrame, *, number: int) -> NDArray[np.float32] | None:
        """Read the scene flow of each point to the next frame, (N, 3) metres; None without it.

        Raises:
            TruthUnusableError: If it labels a different number of points.
        """
        _, arrays = self._arrays_of(frame, number, ("flow",))
        if "flow" not in arrays:
            return None
        return np.asarray(arrays["flow"], dtype=np.float32)

    def folder_of(self, number: int) -> Path:
        """Return the folder of the truth of a frame."""
        return self._entries[number].path.parent

    def index_of(self, number: int) -> int:
        """Return the number of a frame in its folder, the `NNNNNN` of its file."""
        return int(self._entries[number].path.stem)

    def ids_of(self, frame: LidarFrame, *, number: int, name: str) -> NDArray[np.uint8] | None:
        """Read the ids in `semantic` or `semantic19` of a frame; None where truth lacks the array.

        Raises:
            TruthUnusableError: If it labels a different number of points.
        """
        _, arrays = self._arrays_of(frame, number, (name,))
        return None if name not in arrays else np.asarray(arrays[name], dtype=np.uint8)

    def _arrays_of(
        self, frame: LidarFrame, number: int, names: Sequence[str]
    ) -> tuple[Path, dict[str, NDArray[Any]]]:
        """Read the named arrays from the truth of a frame; empty where it has none."""
        if number >= len(self._entries):
            return self._root, {}
        path = self._entries[number].path
        if not path.is_file():
            return path, {}
        with np.load(path) as file:
            arrays = {name: file[name] for name in names if name in file}
        for array in arrays.values():
            if len(array) != len(frame):
                raise TruthUnusableError(
                    f"truth labels {len(array)} points, frame {number} has {len(frame)} "
                    f"({frame.log_id}, {path})"
                )
        return path, arrays


def logs_with_truth(
    bucket: Bucket, truth: Path, *, needs_labels: bool = True
) -> list[tuple[Recording, LogTruth]]:
    """List the logs of a bucket that have truth, with it; of points, unless poses are enough.

    Raises:
        TruthUnusableError: If there is none.
    """
    found = [
        (recording, known)
        for recording in group_recordings(bucket.list())
        if (known := LogTruth.beside(recording, truth, needs_labels=needs_labels)) is not None
    ]
    if not found:
        raise TruthUnusableError(
            f"no log of {bucket.url} has truth in {truth}; deploy/TRUTH.md defines the format"
        )
    return found


def _entries_of(folder: Path) -> Iterator[tuple[_Entry, str]]:
    listing = folder / "frames.json"
    if listing.is_file():
        for row in json.loads(listing.read_text())["frames"]:
            path = folder / f"{row['index']:06d}.npz"
            entry = _Entry(path, row.get("header_stamp"), row.get("log_time"))
            yield entry, row.get("topic", "")
        return
    numbered = sorted(path for path in folder.glob("*.npz") if path.stem.isdigit())
    if numbered:
        for number in range(int(numbered[-1].stem) + 1):
            yield _Entry(folder / f"{number:06d}.npz", None, None), ""


def _is_partial(folder: Path) -> bool:
    """Return True if a folder lists some frames only: the others are not judged."""
    listing = folder / "frames.json"
    return listing.is_file() and bool(json.loads(listing.read_text()).get("partial", False))
