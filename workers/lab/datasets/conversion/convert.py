"""Conversion of a data set: each of its logs to an MCAP file in a bucket, with its truth."""

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from schemas.errors import PermanentError
from schemas.transport.bucket import Bucket, open_bucket
from workers.lab.datasets.conversion.label_files import LabelWriter
from workers.lab.datasets.conversion.log_writer import LogWriter
from workers.lab.datasets.conversion.source import DatasetUnusableError, SourceFrame, SourceLog
from workers.lab.datasets.conversion.truth_writer import ABOUT_FILE, TruthWriter
from workers.lab.datasets.published.catalogue import Layout
from workers.lab.simulation.output.write import growing_file

Outcome = Literal["written", "there already"]


class OutputTakenError(PermanentError):
    """An output exists that this conversion did not write."""


@dataclass(frozen=True, slots=True)
class ConvertedLog:
    """One converted log.

    Attributes:
        log: Key without `.mcap`.
        outcome: Whether it was written now, or by an earlier run.
        frames: Number of frames.
        notes: Sentences about its truth.
    """

    log: str
    outcome: Outcome
    frames: int
    notes: tuple[str, ...]


def convert(
    layout: Layout,
    logs: Sequence[SourceLog],
    *,
    to: str,
    truth: Path,
    labels: Path | None = None,
    force: bool = False,
    on_frame: Callable[[], None] = lambda: None,
) -> Iterator[ConvertedLog]:
    """Write the logs of a data set to a bucket, and their truth to a folder.

    A log appears whole or not at all, after its truth. One that an earlier run has finished is
    kept, so that a killed conversion goes on with the log at which it was killed.

    Args:
        layout: The data set.
        logs: Its logs.
        to: URL or path of the bucket; a folder is made.
        truth: Folder of truth.
        labels: Folder for `.label` files of SemanticKITTI's form; None writes none.
        force: True to replace logs that are there.
        on_frame: Called after each frame.

    Raises:
        OutputTakenError: If a log is there that was not converted from this data set.
        DatasetUnusableError: If a file of the data set is missing or damaged.
    """
    bucket = open_bucket(to, create=True)
    done = {log.key: not force and _is_done(bucket, truth, log, layout) for log in logs}
    for log in logs:
        if done[log.key]:
            for _ in range(log.length):
                on_frame()
            yield ConvertedLog(log.key, "there already", log.length, log.notes)
            continue
        count = _write(bucket, layout, log, truth, labels, on_frame)
        yield ConvertedLog(log.key, "written", count, log.notes)


def _is_done(bucket: Bucket, truth: Path, log: SourceLog, layout: Layout) -> bool:
    """Return True if an earlier run wrote this log and its truth; a foreign log is an error."""
    if bucket.head(f"{log.key}.mcap") is None:
        return False
    about = truth / log.key / ABOUT_FILE
    if about.is_file() and json.loads(about.read_text()).get("layout") == layout.name:
        return True
    raise OutputTakenError(
        f"{log.key}.mcap is there already, without truth of this conversion in {truth / log.key}: "
        f"name another bucket, or replace it with --force ({bucket.url})"
    )


def _write(
    bucket: Bucket,
    layout: Layout,
    log: SourceLog,
    truth: Path,
    labels: Path | None,
    on_frame: Callable[[], None],
) -> int:
    about: dict[str, Any] = {
        "layout": layout.name,
        "name": layout.title,
        "log": log.name,
        "licence": layout.licence,
        "attribution": layout.attribution,
    }
    folder = truth / log.key
    growing = folder.with_name(folder.name + ".part")
    shutil.rmtree(growing, ignore_errors=True)
    local = bucket.folder
    with TemporaryDirectory(prefix="counterpoint-convert-") as made:
        path = (local or Path(made)) / f"{log.key}.mcap"
        with growing_file(path) as stream, TruthWriter(growing, log, about) as told:
            writer = LogWriter(stream, log, about)
            labelled = None if labels is None else LabelWriter(labels / log.key)
            count = 0
            for frame in log.frames():
                _check(frame, log, count)
                told.add(frame, writer.add(frame))
                if labelled is not None:
                    labelled.add(frame)
                count += 1
                on_frame()
            writer.finish()
            told.finish()
            shutil.rmtree(folder, ignore_errors=True)
            growing.replace(folder)
        if local is None:
            bucket.put_file(f"{log.key}.mcap", path)
    return count


def _check(frame: SourceFrame, log: SourceLog, number: int) -> None:
    for name, array in frame.truth.items():
        if len(array) != len(frame.rows):
            raise DatasetUnusableError(
                f"{name} has {len(array)} values, frame {number} of {log.name} has "
                f"{len(frame.rows)} points: labels and points are not of one release"
            )
