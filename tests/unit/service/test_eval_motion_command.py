"""`eval motion` with several streams: lines, folders and plot of each, apart from the others'."""

import json
from pathlib import Path

import pytest
from PIL import Image

from service.cli.main import main
from tests.factories import street_log

KEY = "car-7/2026-03-02/drive"


def test_streams_side_by_side_have_a_line_and_a_folder_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    street_log(tmp_path / "logs" / f"{KEY}.mcap", frames=3, truth=tmp_path / "truth" / KEY)
    argv = ["eval", "motion", "logs", "--truth", "truth", "--frames", "1:"]
    several = ["--stream", "recorded", "--stream", "two-stage:nearest-neighbour"]
    files = ["--labels", "labels", "--pictures", "pictures", "--plot", "several.png"]
    assert main([*argv, *several, *files, "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    streams = ["recorded", "two-stage:nearest-neighbour"]
    assert [(line["log"], line["stream"]) for line in lines] == [
        (log, stream) for log in (KEY, "all") for stream in streams
    ]
    for folder in ("recorded", "two-stage-nearest-neighbour"):
        written = sorted(path.stem for path in (tmp_path / "labels" / folder / KEY).iterdir())
        assert written == ["000001", "000002"]
        assert (tmp_path / "pictures" / folder / "worst.png").is_file()

    assert main([*argv, "--stream", "recorded", "--plot", "one.png", "--labels", "alone"]) == 0
    said = capsys.readouterr().out
    assert "dynamic points, recorded stream" in said
    assert (tmp_path / "alone" / KEY / "000001.npz").is_file()
    with Image.open("one.png") as one, Image.open("several.png") as both:
        assert both.height > one.height

    assert main([*argv, *several]) == 0
    said = capsys.readouterr().out
    assert "side by side" in said
    assert said.count("recorded") >= 4

    monkeypatch.setenv("COUNTERPOINT_SUPERVISED", "recorded")
    assert main([*argv, "--stream", "supervised", "--alone"]) == 0
    assert "supervised: recorded\n" in capsys.readouterr().err
