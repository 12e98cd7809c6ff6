from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from schemas.labels import MotionLabel
from service.cli.evaluate import parse_rows
from service.errors import UsageError
from service.pictures.evaluation_frames import SIZE_PX, draw_worst
from service.pictures.table import draw_table
from workers.lab.evaluation.motion.counts import LogCounts, RangeCounts, StreamCounts
from workers.lab.evaluation.motion.motion import EvaluatedFrame
from workers.lab.evaluation.motion.table import LogEvaluation, evaluation_of

MISSED, FALSE = (250, 210, 40), (255, 70, 70)


def judged(name: str, *, called: bool, moves: bool) -> EvaluatedFrame:
    label = MotionLabel.DYNAMIC if called else MotionLabel.STATIC
    return EvaluatedFrame(
        stream="selfsupervised",
        log_id="x/y",
        name=name,
        points_m=np.array([[30.0, 10.0, 0.0]], np.float32),
        labels=np.array([label], np.uint8),
        confirmed=None,
        truth=np.array([2 if moves else 1], np.uint8),
        kept=None,
    )


def test_each_frame_has_its_picture_and_all_share_a_sheet(tmp_path: Path) -> None:
    frames = [judged("x/y/000003", called=False, moves=True)]
    frames.append(judged("x/y/000001", called=True, moves=False))
    sheet, missed, false = draw_worst(tmp_path / "worst", frames)
    assert sheet.name == "worst.png"
    assert (missed.name, false.name) == ("01-x-y-000003.png", "02-x-y-000001.png")
    scale = SIZE_PX / 160.0
    at = (round((80 - 10) * scale), round((80 - 30) * scale) + 64)
    for path, colour in ((missed, MISSED), (false, FALSE)):
        with Image.open(path) as picture:
            assert picture.getpixel(at) == colour
    assert draw_worst(tmp_path / "none", []) == []


def row(iou_hits: int) -> LogEvaluation:
    counts = StreamCounts()
    counts.by_range[80] = RangeCounts(hits=iou_hits, misses=100 - iou_hits)
    logged = LogCounts(frames=1, streams={"selfsupervised": counts})
    return evaluation_of("x", logged, stream="selfsupervised")


def test_the_plot_grows_with_what_is_in_the_table() -> None:
    low, high = draw_table([row(60)]), draw_table([row(95)])
    assert low.size == high.size
    assert np.asarray(low).sum() < np.asarray(high).sum()
    assert draw_table([row(60), row(95)]).height > low.height


@pytest.mark.parametrize(
    ("text", "rows"),
    [("0::2", [0, 2, 4]), ("1::2", [1, 3]), ("", None), (":2", [0, 1]), ("-1:", [4])],
)
def test_rows_are_a_slice_as_python_writes_it(text: str, rows: list[int] | None) -> None:
    chosen = parse_rows(text)
    assert (None if chosen is None else list(range(5))[chosen]) == rows


@pytest.mark.parametrize("text", ["3", "a:b", "0::0", "1:2:3:4"])
def test_what_is_no_slice_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="--rows must be a slice"):
        parse_rows(text)
