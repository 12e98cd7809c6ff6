"""A pipe or a device that a user names is refused at once; nothing waits for it or reads it up."""

import os
from pathlib import Path

import pytest

from schemas.runtime.named_file import read_named_file
from service.cli.main import main
from service.errors import UsageError
from service.settings.config import load_settings
from workers.checkpoints.errors import WeightsUnusableError
from workers.supervised.adapter import Adapter

pytestmark = pytest.mark.timeout(60)

ADAPTER = """name = "huge"
[profile]
name = "p"
rows = 1000000000
columns = 1024
fov_up_deg = 10.0
fov_down_deg = -25.0
[semantic]
file = "a.onnx"
[[semantic.classes]]
name = "car"
movable = true
"""


@pytest.fixture
def fifo(tmp_path: Path) -> Path:
    os.mkfifo(tmp_path / "fifo")
    return tmp_path / "fifo"


@pytest.mark.parametrize("named", ["/dev/zero", "fifo", "."])
@pytest.mark.parametrize("call", [["config", "--config"], ["inspect"], ["score"]], ids=" ".join)
def test_only_a_regular_file_is_read(
    call: list[str], named: str, fifo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = fifo if named == "fifo" else Path(named)
    assert main([*call, str(path)]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert str(path if "config" in call else path.resolve()) in said


@pytest.mark.parametrize("named", ["/dev/zero", "fifo", "."])
def test_only_a_regular_file_is_read_as_calibration(named: str, fifo: Path) -> None:
    path = fifo if named == "fifo" else Path(named)
    with pytest.raises(UsageError, match=r"camera: .*(pipe or a device|folder)"):
        load_settings(camera=str(path)).mining()


@pytest.mark.parametrize("named", ["/dev/zero", "fifo"])
def test_an_adapter_that_is_no_file_is_refused(named: str, fifo: Path) -> None:
    path = fifo if named == "fifo" else Path(named)
    with pytest.raises(WeightsUnusableError, match="a pipe or a device"):
        Adapter.read(path)


def test_an_adapter_with_more_rows_than_any_lidar_is_refused(tmp_path: Path) -> None:
    (tmp_path / "adapter.toml").write_text(ADAPTER)
    with pytest.raises(WeightsUnusableError, match=r"1000000000 rows.*adapter\.toml"):
        Adapter.read(tmp_path / "adapter.toml")


def test_a_file_of_more_than_the_most_is_refused(tmp_path: Path) -> None:
    (tmp_path / "big").write_bytes(b"x" * 1001)
    assert len(read_named_file(tmp_path / "big", at_most=1001)) == 1001
    with pytest.raises(OSError, match=r"larger than 0\.001 MB"):
        read_named_file(tmp_path / "big", at_most=1000)
