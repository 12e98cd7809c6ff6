"""Outputs are whole, go over nothing of the user's, and may be asked for again."""

import os
from pathlib import Path

import pytest
from PIL import Image

from service.cli.main import main
from service.demo.run import _begin_in
from service.errors import UsageError
from service.output_files import need_folder, need_writable, save_picture, save_text
from tests.unit.service.mined_state import mined_state

PICTURE = Image.new("RGB", (4, 4))


def test_our_own_picture_is_replaced_and_another_only_with_force(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    mined_state(tmp_path / "state")
    call = ["show", "1", "--state", "state", "--out", "scene.png"]
    assert main(call) == 0
    assert main(call) == 0, "the README's command, pasted twice"
    PICTURE.save("scene.png")
    theirs = Path("scene.png").read_bytes()
    capsys.readouterr()
    assert main(call) == 1
    assert "--force" in capsys.readouterr().err
    assert Path("scene.png").read_bytes() == theirs
    assert main([*call, "--force"]) == 0
    assert Path("scene.png").read_bytes() != theirs


def test_a_report_is_replaced_and_a_page_of_somebody_else_is_not(tmp_path: Path) -> None:
    from service.output_files import PAGE_MARK

    file = tmp_path / "report.html"
    for text in ("one", "two"):
        save_text(f"<html>{PAGE_MARK}{text}</html>", file, option="--report", force=False)
    assert "two" in file.read_text()
    file.write_text("<html>mine</html>")
    with pytest.raises(UsageError, match=r"--report: this file exists.*--force"):
        save_text("x", file, option="--report", force=False)
    assert file.read_text() == "<html>mine</html>"


@pytest.mark.parametrize("force", [False, True])
def test_a_device_a_pipe_and_a_folder_are_never_replaced(tmp_path: Path, force: bool) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "pipe", tmp_path / "folder", Path("/dev/full"), Path("/proc/x.png")):
        with pytest.raises(UsageError, match="--out"):
            need_writable(path, option="--out", force=force)


def test_a_write_that_fails_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "a.png"
    save_picture(PICTURE, file, option="--out", force=False)
    before = file.read_bytes()

    def full(self: Image.Image, path: Path, **_: object) -> None:
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", full)
    with pytest.raises(UsageError, match="No space left on device"):
        save_picture(PICTURE, file, option="--out", force=False)
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file], "no half of one beside it"


def test_a_link_is_written_through(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "link.png").symlink_to(tmp_path / "deep" / "a.png")
    save_picture(PICTURE, tmp_path / "link.png", option="--out", force=False)
    assert (tmp_path / "link.png").is_symlink()
    assert (tmp_path / "deep" / "a.png").is_file()


def test_a_file_where_a_folder_is_wanted_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(UsageError, match="--pictures needs a folder, and this is a file"):
        need_folder(tmp_path / "file", option="--pictures")


def test_a_demo_replaces_a_demo_and_no_folder_of_anybody_else(tmp_path: Path) -> None:
    def begin(out: Path, *, force: bool = False) -> None:
        _begin_in(out, remark=lambda _: None, force=force)

    begin(tmp_path / "demo")
    (tmp_path / "demo" / "pictures" / "1.png").write_bytes(b"x")
    begin(tmp_path / "demo")
    assert list((tmp_path / "demo" / "pictures").iterdir()) == []
    mine = tmp_path / "home" / "pictures" / "holiday.jpg"
    mine.parent.mkdir(parents=True)
    mine.write_bytes(b"x")
    with pytest.raises(UsageError, match="--force"):
        begin(tmp_path / "home")
    assert mine.exists()
    begin(tmp_path / "home", force=True)
    assert not mine.exists()


def test_logs_that_were_not_simulated_are_not_mixed_with_those_that_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "real.mcap").write_bytes(b"x")
    assert main(["simulate", "--scenes", "1", "--out", str(tmp_path)]) == 1
    assert "logs/real.mcap" in capsys.readouterr().err


def test_truth_is_not_written_over_by_labels(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "000000.npz").write_bytes(b"x")
    truth = str(tmp_path / "truth")
    assert main(["eval", "motion", str(tmp_path), "--truth", truth, "--labels", truth]) == 1
    assert "not empty" in capsys.readouterr().err


def test_other_weights_are_replaced_only_with_force(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "lmnet.safetensors").write_bytes(b"mine")
    (tmp_path / "checkpoint").write_bytes(b"PK")
    call = ["weights", "import", str(tmp_path / "checkpoint"), "--network", "lmnet"]
    assert main([*call, "--config", "lmnet-kitti360", "--out", str(tmp_path / "out")]) == 1
    assert "--force" in capsys.readouterr().err
    assert (tmp_path / "out" / "lmnet.safetensors").read_bytes() == b"mine"
