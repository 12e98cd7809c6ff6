from pathlib import Path

import pytest

from service.cli.main import main
from service.cli.planting import planting_of


@pytest.mark.parametrize(
    ("arguments", "because"),
    [
        (["fleet", "--table", "every"], "planted or natural"),
        (["s3://fleet"], "--truth"),
        (["file:///nowhere/fleet", "--table", "planted"], "/nowhere/fleet"),
        (["logs", "--truth", "t", "--plant", "--frames", "28"], "A:B with A under B"),
        (["logs", "--truth", "t", "--plant", "--frames", "28:28"], "A:B with A under B"),
        (["logs", "--truth", "t", "--plant", "--frames", "-3:4"], "A:B with A under B"),
        (["logs", "--truth", "t", "--plant", "--share", "1/0"], "over 0 and under 1"),
        (["logs", "--truth", "t", "--plant", "--share", "1"], "over 0 and under 1"),
        (["logs", "--truth", "t", "--plant", "--share", "nan"], "over 0 and under 1"),
        (["logs", "--truth", "t", "--plant", "--answer", "both"], "points or boxes"),
        (["logs", "--truth", "t", "--planted", "p.json"], "give --plant"),
        (["logs", "--truth", "t", "--plant", "--planted", "/"], "--planted"),
        (["logs", "--truth", "t", "--plant", "--table", "natural"], "leave --table out"),
        (["file:///nowhere/fleet", "--plant"], "/nowhere/fleet"),
    ],
)
def test_what_cannot_be_measured_is_refused_in_a_sentence(
    arguments: list[str], because: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "failures", *arguments]) == 1
    said = capsys.readouterr()
    assert because in said.err
    assert said.out == ""


def test_a_bucket_without_truth_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "logs").mkdir()
    assert main(["bench", "failures", str(tmp_path)]) == 1
    assert "is no fleet of `simulate`" in capsys.readouterr().err


def test_options_of_planting_are_read_as_they_are_written() -> None:
    planting = planting_of(variants=3, seed=7, frames="28:", share="0.05")
    assert (planting.variants, planting.seed, planting.share) == (3, 7, 0.05)
    assert (planting.frames.first, planting.frames.end) == (28, None)
    assert str(planting_of(variants=1, seed=0, frames="4:28", share="1/6").frames) == "4:28"
    in_boxes = planting_of(variants=1, seed=0, frames="0:", share="1/6", answer="boxes")
    assert in_boxes.answer == "boxes"
