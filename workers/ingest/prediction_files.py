"""Files with a model's answer next to the logs: labels of points per cloud, or Parquet of boxes."""

import json
from functools import lru_cache
from typing import Final

import numpy as np

from schemas.canonical import canonical_json
from schemas.errors import BucketRefusedError, ObjectChangedError
from schemas.frame import RecordedLabels
from schemas.recorded_source import PredictionFiles
from schemas.semantickitti import MOVABLE, MOVING, PLAIN
from schemas.transport.bucket import Bucket, ObjectMeta, open_bucket
from workers.errors import CloudUnreadableError, LogUnusableError, PredictionsMissingError
from workers.ingest.limits import MAX_POINTS
from workers.ingest.pointcloud import DecodedCloud
from workers.ingest.recorded_labels import recorded_classes

LABEL_SUFFIX: Final = ".label"
BOX_FILES: Final = ("{name}.parquet", "{name}/boxes.parquet")
CLASSES_FILES: Final = ("{name}/classes.json", "classes.json")

STAMP_DIGITS: Final = 16
"""Digits from which the name of a file is a stamp in nanoseconds, and not a number."""

MAX_FILES: Final = 1_000_000
"""Files of one log; 28 hours at 10 Hz."""

MAX_CLASSES_BYTES: Final = 1 << 20
SAMPLED_FILES: Final = 8
"""Files that are read to see if any label of a log moves."""


def open_predictions(url: str) -> Bucket:
    """Open the folder or bucket of the setting `predictions`.

    Raises:
        BucketRefusedError: If it is none, or does not exist.
    """
    try:
        return open_bucket(url)
    except BucketRefusedError as error:
        raise BucketRefusedError(f"predictions: {error}") from None


def find_prediction_files(url: str, log_id: str) -> tuple[PredictionFiles, str]:
    """Find the files of a log, by its whole name and by the last part of it.

    Args:
        url: The setting `predictions`.
        log_id: The log.

    Returns:
        The files, and the classes of their labels as JSON; empty where no file names them.

    Raises:
        PredictionsMissingError: If there are none; the message names what was looked for.
    """
    bucket = open_predictions(url)
    name, key, stems = _located(bucket, url, log_id)
    if not stems:
        return PredictionFiles(kind="boxes", key=key), _classes(bucket, name)
    by_stamp = len(stems[0]) >= STAMP_DIGITS
    found = PredictionFiles(kind="labels", key=key, by_stamp=by_stamp)
    return found, _classes(bucket, name) or _usual_classes(bucket, name, stems)


def need_prediction_files(url: str, log_id: str) -> None:
    """Check that a log has files, without reading them.

    Raises:
        PredictionsMissingError: If there are none; the message names what was looked for.
    """
    _located(open_predictions(url), url, log_id)


def _located(bucket: Bucket, url: str, log_id: str) -> tuple[str, str, list[str]]:
    """Return the name of the files of a log, their key, and the stems of labels; none: boxes."""
    names = list(dict.fromkeys((log_id, log_id.rpartition("/")[2])))
    for name in names:
        for key in (pattern.format(name=name) for pattern in BOX_FILES):
            if bucket.head(key) is not None:
                return name, key, []
        if stems := _stems(bucket, name):
            return name, f"{name}/", stems
    raise PredictionsMissingError(
        f"no predictions for {log_id}: none of {names[-1]}/000000{LABEL_SUFFIX}, "
        f"{' and '.join(each.format(name=names[-1]) for each in BOX_FILES)} is in the folder of "
        f"the setting predictions ({url})"
    )


class LabelFiles:
    """Labels of the clouds of one shard, a file per cloud.

    Args:
        url: The setting `predictions`.
        files: Names of the files.
        classes_json: Classes of their labels.
    """

    def __init__(self, url: str, files: PredictionFiles, classes_json: str) -> None:
        self._bucket = open_predictions(url)
        self._files = files
        self._classes = recorded_classes(classes_json)

    def labels(self, cloud: DecodedCloud, number: int) -> RecordedLabels | None:
        """Read the labels of a cloud.

        Args:
            cloud: The cloud.
            number: Its number in the log, from 0 on.

        Returns:
            None where there is no file for it.

        Raises:
            CloudUnreadableError: If the file has another number of labels than the cloud points.
        """
        if not self._files.by_stamp and self._files.first_cloud < 0:
            return None
        stem = f"{cloud.stamp_ns}" if self._files.by_stamp else f"{number:06d}"
        key = f"{self._files.key}{stem}{LABEL_SUFFIX}"
        try:
            data = self._bucket.read_all(key, at_most=4 * MAX_POINTS)
        except ObjectChangedError:
            return None
        if len(data) != 4 * len(cloud):
            raise CloudUnreadableError(
                f"cannot read labels: {key} has {len(data)} bytes, {len(cloud)} points need "
                f"{4 * len(cloud)}: the frame counts as without prediction; write one uint32 per "
                "point of the message, invalid points included"
            )
        class_id = (np.frombuffer(data, "<u4") & 0xFFFF).astype(np.uint16)
        return RecordedLabels(
            class_id=class_id, motion=None, confidence=None, classes=self._classes
        )

    def missing(self, count: int) -> str:
        """Describe clouds without a file."""
        if not self._files.by_stamp and self._files.first_cloud < 0:
            return (
                "the log has no index that counts its clouds, so no file is found by the number "
                f"of a cloud: name files by stamps in nanoseconds ({self._files.key})"
            )
        return (
            f"{count} clouds have no file of labels: they count as without prediction; write one "
            f"file per cloud, as {self._files.key}000000{LABEL_SUFFIX} ({self._bucket.url})"
        )


def _stems(bucket: Bucket, name: str) -> list[str]:
    found: list[str] = []
    for meta in bucket.list(prefix=name):
        folder, _, file = meta.key.rpartition("/")
        stem = file.removesuffix(LABEL_SUFFIX)
        if folder == name and file.endswith(LABEL_SUFFIX) and stem.isdecimal():
            found.append(stem)
        if len(found) >= MAX_FILES:
            break
    return sorted(found)


def _classes(bucket: Bucket, name: str) -> str:
    """Read the classes next to the files: id to an object {name, movable, moving}; empty: none."""
    for key in (pattern.format(name=name) for pattern in CLASSES_FILES):
        found: ObjectMeta | None = bucket.head(key)
        if found is None:
            continue
        try:
            stated = json.loads(bucket.read_all(key, at_most=MAX_CLASSES_BYTES))
            classes = {
                str(class_id): entry if isinstance(entry, str) else json.dumps(entry)
                for class_id, entry in stated.items()
            }
        except (ValueError, AttributeError, RecursionError) as error:
            raise LogUnusableError(
                f"cannot read the classes of predictions: {error}; write "
                '{"10": {"name": "car", "movable": true, "moving": false}} '
                f"({bucket.url}, {key})"
            ) from None
        text = canonical_json(classes).decode()
        recorded_classes(text)
        return text
    return ""


def _usual_classes(bucket: Bucket, name: str, stems: list[str]) -> str:
    """Return the usual classes, those that move only where a label of the log does.

    A network that names what it sees and not what moves writes 10 for every car. Where no sampled
    file has a moving label, the files state no motion.
    """
    step = max(1, len(stems) // SAMPLED_FILES)
    keys = [f"{name}/{stem}{LABEL_SUFFIX}" for stem in stems[::step][:SAMPLED_FILES]]
    seen: set[int] = set()
    for key in keys:
        data = bucket.read_all(key, at_most=4 * MAX_POINTS)
        ids = np.frombuffer(data[: len(data) // 4 * 4], "<u4") & 0xFFFF
        seen.update(np.unique(ids).tolist())
    return usual_classes(with_motion=bool(seen & (MOVING.keys() | {9})))


@lru_cache(maxsize=2)
def usual_classes(*, with_motion: bool) -> str:
    """Return the classes of SemanticKITTI's format as JSON."""
    known = [(PLAIN, False, False), (MOVABLE, True, False)]
    if with_motion:
        known.append((MOVING, True, True))
    classes = {
        str(class_id): json.dumps({"name": name, "movable": movable, "moving": moving})
        for names, movable, moving in known
        for class_id, name in names.items()
    }
    return canonical_json(classes).decode()
