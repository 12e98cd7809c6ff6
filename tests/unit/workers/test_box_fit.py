"""Boxes of another space are doubted: true boxes of a real street, moved, turned and halved."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from numpy.typing import NDArray
from pyarrow import parquet

from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from tests.detector_output import read_truth
from tests.tiny_logs import settings
from workers.model_answer import read_answer
from workers.points.se3 import inverse
from workers.supervised.box_fit import DOUBT

FOLDER = "pandaset/panda-01/2019-05-11"
LOG = "pandaset-002"

Columns = dict[str, NDArray[np.float64]]
Change = Callable[[Columns], None]


def as_they_are(boxes: Columns) -> None:
    pass


def of_a_detector(boxes: Columns) -> None:
    rng = np.random.default_rng(1)
    for name in ("x", "y"):
        boxes[name] += rng.normal(0.0, 0.25, boxes[name].shape)
    for name in ("length", "width", "height"):
        boxes[name] *= rng.normal(1.0, 0.1, boxes[name].shape)
    boxes["yaw"] += rng.normal(0.0, 0.1, boxes["yaw"].shape)


def mirrored(boxes: Columns) -> None:
    for name in ("y", "yaw"):
        boxes[name] *= -1.0


def turned(boxes: Columns) -> None:
    boxes["x"], boxes["y"] = boxes["y"], -boxes["x"]
    boxes["yaw"] -= np.pi / 2


def exchanged(boxes: Columns) -> None:
    boxes["length"], boxes["width"] = boxes["width"], boxes["length"]


def halved(boxes: Columns) -> None:
    for name in ("length", "width", "height"):
        boxes[name] /= 2.0


def lifted(boxes: Columns) -> None:
    boxes["z"] += 1.7


@pytest.mark.reference
@pytest.mark.parametrize(
    ("change", "is_doubted"),
    [
        (as_they_are, False),
        (of_a_detector, False),
        (mirrored, True),
        (turned, True),
        (exchanged, True),
        (halved, True),
        (lifted, True),
    ],
)
def test_boxes_that_cut_through_what_stands_are_doubted(
    reference: Path, tmp_path: Path, change: Change, is_doubted: bool
) -> None:
    truth = read_truth(reference / "data" / "truth" / FOLDER / LOG)
    boxes: Columns = {}
    stamps: list[int] = []
    rows: list[list[float]] = []
    for frame in range(10):  # the car stands
        stamp_ns = int(truth.stamp_ns[frame])
        lidar_from_map = inverse(truth.pose(stamp_ns))
        turn = float(np.arctan2(lidar_from_map[1, 0], lidar_from_map[0, 0]))
        for box in truth.boxes[frame]:
            centre_m = lidar_from_map[:3, :3] @ box.centre_m + lidar_from_map[:3, 3]
            stamps.append(stamp_ns)
            rows.append([*centre_m.tolist(), *box.size_m, box.yaw_rad + turn, 0.0, 0.0])
    names = ("x", "y", "z", "length", "width", "height", "yaw", "vx", "vy")
    boxes = dict(zip(names, np.array(rows).T.copy(), strict=True))
    change(boxes)
    parquet.write_table(pa.table({"stamp_ns": stamps, **boxes}), tmp_path / f"{LOG}.parquet")
    bucket = open_bucket(str(reference / "data" / "logs" / FOLDER))
    (recording,) = [each for each in group_recordings(bucket.list()) if each.log_id == LOG]
    using = settings(supervised="recorded").model_copy(update={"predictions": str(tmp_path)})
    answer = read_answer(bucket, recording, using)
    assert answer is not None
    assert answer.reason == (DOUBT if is_doubted else "")
