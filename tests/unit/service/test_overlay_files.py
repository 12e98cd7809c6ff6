"""What `show` says when an overlay is not what it should be: which file, and what to do."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from service.cli.main import main
from tests.unit.service.mined_state import mined_state


@pytest.fixture
def overlays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    monkeypatch.chdir(tmp_path)
    return mined_state(tmp_path / "state")


def show(*more: str) -> int:
    return main(["show", "1", "--state", "state", "--out", "scene.png", *more])


def _of_another_scene(overlays: list[Path]) -> None:
    overlays[0].write_bytes(overlays[1].read_bytes())


def _damaged(overlays: list[Path]) -> None:
    overlays[0].write_bytes(overlays[0].read_bytes()[:-7])


def _a_pipe(overlays: list[Path]) -> None:
    overlays[0].unlink()
    os.mkfifo(overlays[0])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        pytest.param(_of_another_scene, "is of scene car-7/a/lidar/", id="another scene's"),
        pytest.param(_damaged, "is unreadable: damaged", id="damaged"),
        pytest.param(_a_pipe, "a pipe or a device lies there", id="pipe"),
    ],
)
def test_an_overlay_that_cannot_be_drawn_is_named(
    change: Callable[[list[Path]], None],
    says: str,
    overlays: list[Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    change(overlays)
    assert show() == 1
    said = capsys.readouterr().err
    assert says in said
    assert overlays[0].name in said
    assert said.count("\n") == 1
    assert not Path("scene.png").exists()


def test_an_overlay_where_it_belongs_is_drawn(overlays: list[Path]) -> None:
    assert show() == 0
    with Image.open("scene.png") as picture:
        assert picture.size == (1720, 1250)


@pytest.mark.usefixtures("overlays")
def test_the_reasons_of_the_picture_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["top", "-n", "1", "--state", "state", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["reasons"]
    assert listed
    assert show() == 0
    printed = capsys.readouterr().out.splitlines()
    assert [line[3:] for line in printed if not line.startswith(" ")] == listed
