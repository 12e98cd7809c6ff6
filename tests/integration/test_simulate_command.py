"""`counterpoint simulate`: the same bytes for any number of processes, into folders and buckets."""

from hashlib import sha256
from pathlib import Path

import pytest

from schemas.bucket import open_bucket
from schemas.recordings import group_recordings
from service.cli.main import main
from tests.integration.object_store import Ceph
from workers.evaluation.truth import LogTruth

pytestmark = pytest.mark.integration
FEW = ["--scenes", "11", "--seed", "5", "--failures", "0.2", "--columns", "64"]


def digests(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_one_process_and_two_write_the_same_bytes_to_a_folder_and_to_a_bucket(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ceph: Ceph
) -> None:
    one = tmp_path / "one"
    assert main(["simulate", *FEW, "--out", str(one)]) == 0
    name = ceph.make_bucket()
    for variable, value in ceph.environment().items():
        monkeypatch.setenv(variable, value)
    assert main(["simulate", *FEW, "--workers", "2", "--out", f"s3://{name}/week 1"]) == 0
    stored = open_bucket(f"s3://{name}/week 1")
    there = {each.key: sha256(stored.read_all(each.key)).hexdigest() for each in stored.list()}
    assert there == digests(one)

    recordings = group_recordings(open_bucket(str(one / "logs")).list())
    assert len(recordings) == 2
    for recording in recordings:
        truth = LogTruth.beside(recording, one / "truth")
        assert truth is not None
        assert len(truth) in (20, 200)
