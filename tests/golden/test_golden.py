"""Proves the project against the reference outputs, one test per file."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.golden.__main__ import main
from tests.golden.checks import check_file, check_of, files_in
from tests.reference_folder import ROOT, reference_folder

GOLDEN = reference_folder() / "golden"
NAMES = files_in(GOLDEN)
SMALL = "geometry/residual_images.npz"


@pytest.mark.reference
@pytest.mark.parametrize("name", NAMES or ["geometry/range_projection_000000.npz"])
def test_outputs_are_those_of_the_published_code(reference: Path, name: str) -> None:
    checked = check_file(reference / "golden", name)
    assert checked.differences, checked.problem
    assert [each for each in checked.differences if not each.holds] == []


def test_a_file_that_no_part_claims_has_no_check() -> None:
    assert check_of("other/a.npz") is None


def _fusion(folder: Path, *, fused: int) -> None:
    (folder / "fusion").mkdir(parents=True)
    np.savez(
        folder / "fusion" / "kitti360_000007.npz",
        semantic=np.array([26, 26, 11], np.int16),
        motion=np.array([2, 1, 2], np.int16),
        fused=np.array([fused, 26, 11], np.int16),
    )


def test_a_folder_of_other_frames_is_compared_and_every_file_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _fusion(tmp_path, fused=202)
    (tmp_path / "other").mkdir()
    np.savez(tmp_path / "other" / "frustum.npz", points=np.zeros(3))
    (tmp_path / "geometry").mkdir()
    np.savez(tmp_path / SMALL, k1_frame1=np.zeros((64, 2048), np.float32))
    assert main([str(tmp_path)]) == 0
    said = capsys.readouterr().out
    rows = {line.split()[1]: line.rstrip() for line in said.splitlines() if ".npz" in line}
    assert rows["kitti360_000007.npz"].endswith("holds")
    assert rows["frustum.npz"].endswith("not checked")
    assert "needs geometry/calibration.json" in rows["residual_images.npz"]
    assert rows["residual_images.npz"].endswith("not checked")
    assert "3 files: 1 hold, 0 fail, 2 not checked" in said


def test_one_wrong_point_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _fusion(tmp_path, fused=26)
    assert main([str(tmp_path)]) == 1
    assert "FAILS" in capsys.readouterr().out


def test_a_damaged_file_fails_and_the_others_are_still_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _fusion(tmp_path, fused=202)
    whole = (tmp_path / "fusion" / "kitti360_000007.npz").read_bytes()
    (tmp_path / "fusion" / "kitti360_000008.npz").write_bytes(whole[: len(whole) // 2])
    assert main([str(tmp_path)]) == 1
    assert "2 files: 1 hold, 1 fail, 0 not checked" in capsys.readouterr().out


def test_a_file_of_an_unknown_name_or_form_is_listed_as_not_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "fusion").mkdir()
    (tmp_path / "geometry").mkdir()
    np.savez(tmp_path / "geometry" / "knn_backprojection_first.npz", argmax_image=np.zeros((4, 4)))
    np.savez(tmp_path / "fusion" / "kitti360_000009.npz", other=np.zeros(3))
    assert main([str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "2 files: 0 hold, 0 fail, 2 not checked" in said
    assert "a name that ends in a frame number" in said
    assert "needs the array semantic" in said


def test_a_folder_without_reference_outputs_is_refused(tmp_path: Path) -> None:
    """As `make golden` runs it, so that the exit code is the command's."""
    ran = subprocess.run(
        [sys.executable, "-m", "tests.golden", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
    )
    assert ran.returncode == 2
    assert "usage" in ran.stderr
    assert main([str(tmp_path / "nowhere")]) == 2
