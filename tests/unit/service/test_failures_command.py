from pathlib import Path

import pytest

from service.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "because"),
    [
        (["fleet", "--table", "every"], "planted or natural"),
        (["s3://fleet"], "--truth"),
        (["file:///nowhere/fleet", "--table", "planted"], "/nowhere/fleet"),
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
