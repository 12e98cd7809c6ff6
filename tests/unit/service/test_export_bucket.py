"""Exports into a bucket: whole scenes, resumed by another machine, and refused where it must be."""

import json
from pathlib import Path

import pytest

from schemas.errors import BucketUnreachableError
from schemas.transport.bucket import Bucket, open_bucket
from service.cli.export_bucket import BucketSink
from service.curation.selection import Selection
from service.errors import StateInUseError, UsageError
from service.export.formats import FORMATS
from service.export.journal import NAME
from service.export.running import ExportReport, run_export
from tests.export_world import ExportWorld, files_of, made_world


@pytest.fixture
def world(tmp_path: Path) -> ExportWorld:
    return made_world(tmp_path)


@pytest.fixture
def bucket() -> Bucket:
    return open_bucket("memory://exports")


def sent(
    world: ExportWorld, week: Selection, form: str, bucket: Bucket, work: Path
) -> ExportReport:
    """Export by a machine of its own: its working folder is new."""
    work.mkdir()
    opener = world.opener(week)
    return run_export(week, FORMATS[form], work, opener, sink=BucketSink(bucket))


def keys(bucket: Bucket) -> list[str]:
    return sorted(meta.key for meta in bucket.list())


@pytest.mark.parametrize("form", ["json", "mcap", "semantickitti", "nuscenes-lidarseg"])
def test_a_bucket_gets_the_files_of_a_folder(
    world: ExportWorld, bucket: Bucket, tmp_path: Path, form: str
) -> None:
    week = world.selection()
    sent(world, week, form, bucket, tmp_path / "work")
    world.export(week, form, tmp_path / "out")
    assert keys(bucket) == list(files_of(tmp_path / "out"))
    for key in keys(bucket):
        if form != "mcap" or key.endswith(".json"):  # times of writing are in the files of MCAP
            assert bucket.read_all(key) == (tmp_path / "out" / key).read_bytes(), key
    assert list(files_of(tmp_path / "work")) == [NAME], "scenes do not stay in the working folder"


def test_another_machine_goes_on_and_writes_again_what_is_gone_or_has_changed(
    world: ExportWorld, bucket: Bucket, tmp_path: Path
) -> None:
    week = world.selection()
    first = sent(world, week, "semantickitti", bucket, tmp_path / "one")
    again = sent(world, week, "semantickitti", bucket, tmp_path / "two")
    assert (len(first.written), again.written, len(again.kept)) == (2, {}, 2)
    place = first.written[week.scenes[0].scene_id].place
    for key in keys(bucket):
        if key.startswith(f"{place}/"):
            bucket.delete(key)
    bucket.put(f"{place}x/left", b"of a neighbour")
    third = sent(world, week, "semantickitti", bucket, tmp_path / "three")
    assert (len(third.written), len(third.kept)) == (1, 1)
    assert f"{place}x/left" in keys(bucket)


def test_files_that_a_scene_no_longer_has_are_deleted(bucket: Bucket, tmp_path: Path) -> None:
    sink = BucketSink(bucket)
    for names in (("a", "b"), ("b", "c")):
        folder = tmp_path / "".join(names)
        folder.mkdir()
        for name in names:
            (folder / name).write_text(name)
        sink.send(folder, "sequences/00")
    assert keys(bucket) == ["sequences/00/b", "sequences/00/c"]


def test_a_store_that_goes_away_leaves_whole_scenes_and_their_journal(
    world: ExportWorld, bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    week, put = world.selection(), Bucket.put
    count = 0

    def goes_away(self: Bucket, key: str, data: bytes) -> None:
        nonlocal count
        count += key.endswith(".mcap")
        if count > 1:
            raise BucketUnreachableError("no answer")
        put(self, key, data)

    monkeypatch.setattr(Bucket, "put", goes_away)
    with pytest.raises(BucketUnreachableError):
        sent(world, week, "mcap", bucket, tmp_path / "one")
    monkeypatch.undo()
    lines = [json.loads(line) for line in bucket.read_all(NAME).splitlines()]
    assert [line["place"] for line in lines[1:]] == [
        key for key in keys(bucket) if key.endswith(".mcap")
    ]
    again = sent(world, week, "mcap", bucket, tmp_path / "two")
    assert (len(again.written), len(again.kept)) == (1, 1)


def test_foreign_objects_and_other_exports_are_refused(
    world: ExportWorld, bucket: Bucket, tmp_path: Path
) -> None:
    bucket.put("thesis.tex", b"mine")
    with pytest.raises(UsageError, match=r"files that no export wrote.*memory://exports"):
        sent(world, world.selection(), "json", bucket, tmp_path / "one")
    bucket.delete("thesis.tex")
    sent(world, world.selection(), "json", bucket, tmp_path / "two")
    with pytest.raises(UsageError, match=r"export of selection 'week' as json.*memory://exports"):
        sent(world, world.selection("other"), "json", bucket, tmp_path / "three")


def test_a_second_export_at_once_is_recognised(bucket: Bucket) -> None:
    one, other = BucketSink(bucket), BucketSink(bucket)
    for sink in (one, other):
        assert sink.read_journal(NAME) is None
    one.write_journal(NAME, b"one")
    one.write_journal(NAME, b"one, two")
    with pytest.raises(StateInUseError, match="another export into this bucket runs"):
        other.write_journal(NAME, b"other")
    assert bucket.read_all(NAME) == b"one, two"
