"""`counterpoint simulate`: the same bytes for any number of processes, into folders and buckets."""

import hashlib
from pathlib import Path

import pytest

from schemas.bucket import open_bucket
from schemas.recordings import group_recordings
from service.cli.main import main
from tests.integration.small_s3 import SmallS3
from workers.evaluation.truth import LogTruth

pytestmark = pytest.mark.integration
FEW = ["--scenes", "11", "--seed", "5", "--failures", "0.2", "--columns", "64"]


def digests(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_one_process_and_two_write_the_same_bytes_to_a_folder_and_to_a_bucket(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    assert main(["simulate", *FEW, "--out", str(one)]) == 0
    with SmallS3(tmp_path / "s3") as store:
        (tmp_path / "s3" / "fleet").mkdir(parents=True)
        for name, value in store.environment.items():
            monkeypatch.setenv(name, value)
        assert main(["simulate", *FEW, "--workers", "2", "--out", "s3://fleet/week"]) == 0
    assert main(["simulate", *FEW, "--workers", "2", "--out", str(two)]) == 0
    written = digests(one)
    assert written == digests(two) == digests(tmp_path / "s3" / "fleet" / "week")

    recordings = group_recordings(open_bucket(str(one / "logs")).list())
    assert len(recordings) == 2
    for recording in recordings:
        truth = LogTruth.beside(recording, one / "truth")
        assert truth is not None
        assert len(truth) in (20, 200)
