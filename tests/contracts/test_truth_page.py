"""The page on truth: what it shows is read as it says, and it names whatever is read."""

import re
from pathlib import Path

import numpy as np
import pytest

from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from tests.factories import frame
from workers.lab.evaluation.truth.class_table import (
    COARSE,
    SEMANTIC_KITTI,
    coarse_of_ids,
    coarse_of_names,
)
from workers.lab.evaluation.truth.truth import LogTruth

PAGE = Path(__file__).resolve().parents[2] / "deploy" / "TRUTH.md"
KEY = "car-7/2026-11-20/drive"


def page() -> str:
    return PAGE.read_text()


def test_the_example_writes_truth_that_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", page(), re.DOTALL)
    labels = [(np.array([7, 8, 7]), np.array([2, 1, 0])), (np.array([8]), np.array([1]))]
    exec(example, {"labels": labels})  # noqa: S102  what the page tells a person to run
    (tmp_path / f"logs/{KEY}.mcap").parent.mkdir(parents=True)
    (tmp_path / f"logs/{KEY}.mcap").write_bytes(b"a log")
    (recording,) = group_recordings(open_bucket(str(tmp_path / "logs")).list())
    truth = LogTruth.beside(recording, tmp_path / "truth")
    assert truth is not None
    assert len(truth) == 2
    known = truth.of(frame(np.zeros((3, 3))), number=0)
    assert known is not None
    assert known.motion.tolist() == [2, 1, 0]
    classes = truth.classes_of(frame(np.zeros((3, 3))), number=0)
    assert classes is not None
    assert [COARSE[each] for each in classes] == ["car", "none", "car"]


def test_the_classes_on_the_page_are_understood(tmp_path: Path) -> None:
    (example,) = re.findall(r"## classes\.json.*?```json\n(.*?)```", page(), re.DOTALL)
    (tmp_path / "classes.json").write_text(example)
    table = coarse_of_ids(tmp_path)
    assert table is not None
    assert [COARSE[table[each]] for each in (0, 7, 9, 200)] == [
        "none",
        "car",
        "other_static",
        "none",
    ]


def test_every_number_of_a_class_stands_on_the_page() -> None:
    told = re.findall(r"^\| (\d+) \| ([\w-]+) \| (\w+) \|$", page(), re.MULTILINE)
    coarse = [COARSE[each] for each in coarse_of_names(SEMANTIC_KITTI)]
    assert told == [
        (str(number), name, as_what)
        for number, (name, as_what) in enumerate(zip(SEMANTIC_KITTI, coarse, strict=True))
    ]
