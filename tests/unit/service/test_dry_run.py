"""A dry run lists what would be mined, estimates by bytes what it did not open, writes nothing."""

import json
import os
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from schemas.layers import Layers
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from schemas.work import ClaimRequest, MineLease, MiningStats, PlanLease, Recording
from service.cli.main import main
from service.dry_run import (
    DEFAULT_SECONDS_PER_FRAME,
    MOST_LOOKED_INTO,
    DryLog,
    DryRun,
    plan_dry_run,
)
from service.errors import NothingFoundError, OtherBucketError, StateUnusableError
from service.settings.config import load_settings
from service.store.engine import DATABASE_NAME, open_store
from service.store.served_bucket import note_served
from tests.contracts.ledger_world import World, mined, plan_of, shard_commit
from tests.tiny_logs import Recorder, drive
from workers.version import layers_of, parts_of, version_of


@pytest.fixture(autouse=True)
def _no_settings_from_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith("COUNTERPOINT_")]:
        monkeypatch.delenv(name)


def bucket_of(folder: Path, seconds: Sequence[int]) -> Path:
    for number, length_s in enumerate(seconds):
        log = folder / "logs" / f"car-{number}" / "today" / "drive.mcap"
        log.parent.mkdir(parents=True)
        log.write_bytes(Recorder().write(drive(length_s)))
    return folder / "logs"


def dry_run(folder: Path, **flags: Any) -> DryRun:
    settings = load_settings(bucket=str(folder / "logs"), state=folder / "state", **flags)
    return plan_dry_run(settings)


def test_it_counts_the_frames_of_a_few_logs_and_takes_the_default_pace(tmp_path: Path) -> None:
    bucket_of(tmp_path, (2, 3))
    found = dry_run(tmp_path, workers=5)
    assert [(log.log_id, log.frames) for log in found.logs] == [
        ("car-0/today/drive", 20),
        ("car-1/today/drive", 30),
    ]
    assert found.frames == 50
    assert found.duration_s == pytest.approx(4.8, abs=0.1)
    assert found.seconds_per_frame == DEFAULT_SECONDS_PER_FRAME
    assert found.pace_from.startswith("0 frames are mined in this state, too few")
    assert found.hours == pytest.approx(50 * DEFAULT_SECONDS_PER_FRAME / 5 / 3600)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["logs"]


def test_what_is_no_log_is_named(tmp_path: Path) -> None:
    (bucket_of(tmp_path, (2,)) / "notes.txt").write_text("x")
    (named,) = dry_run(tmp_path).skipped.named
    assert (named.name, named.why) == ("notes.txt", "is no .mcap file")
    assert dry_run(tmp_path, exclude=("*.txt",)).skipped.count == 0


def test_patterns_choose_the_logs(tmp_path: Path) -> None:
    bucket_of(tmp_path, (1, 1, 1))
    found = dry_run(tmp_path, include=["car-[12]/*"], exclude=["*-2/*"])
    assert [log.log_id for log in found.logs] == ["car-1/today/drive"]
    with pytest.raises(NothingFoundError, match=r"no \.mcap log that counts"):
        dry_run(tmp_path, include=["bus-*"])


def test_of_many_logs_only_some_are_opened_and_the_rest_follows_from_bytes(tmp_path: Path) -> None:
    logs = bucket_of(tmp_path, (1,))
    one = next(logs.rglob("*.mcap")).read_bytes()
    for number in range(1, 100):
        (logs / f"log-{number:03}.mcap").write_bytes(one)
    found = dry_run(tmp_path)
    assert found.looked_into == MOST_LOOKED_INTO
    opened = [number for number, log in enumerate(found.logs) if log.frames is not None]
    assert (opened[0], opened[-1], len(opened)) == (0, 99, MOST_LOOKED_INTO)
    assert max(b - a for a, b in pairwise(opened)) == 4
    assert found.frames == 1000


def test_a_log_that_cannot_be_mined_says_why_and_counts_no_frames(tmp_path: Path) -> None:
    logs = bucket_of(tmp_path, (1,))
    (logs / "junk.mcap").write_bytes(b"no log at all" * 100)
    found = dry_run(tmp_path)
    junk = next(log for log in found.logs if log.log_id == "junk")
    assert junk.frames == 0
    assert junk.problem
    assert found.frames == 10


def test_a_state_that_has_mined_tells_the_pace(tmp_path: Path) -> None:
    bucket_of(tmp_path, (1,))
    (tmp_path / "state").mkdir()
    with closing(open_store(tmp_path / "state")) as store:
        world = World.on(store)
        world.listed("drive")
        world.plan_all()
        lease = world.mine_lease()
        records = mined(lease.shard, lease.recording)
        stats = MiningStats(frames=400, stage_s={"supervised": 60.0, "selfsupervised": 40.0})
        commit = shard_commit(lease, records).model_copy(update={"stats": stats})
        assert world.ledger.commit(commit, records).ok
    found = dry_run(tmp_path)
    assert found.seconds_per_frame == pytest.approx(0.25)
    assert found.pace_from == "measured on 400 frames mined in this state"


def test_other_parts_are_not_estimated_by_the_time_of_the_default(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bucket_of(tmp_path, (1,))
    found = dry_run(tmp_path, supervised="salsanext-lmnet:published", selfsupervised="paper")
    assert (found.frames, found.seconds_per_frame, found.hours) == (10, None, None)
    assert "salsanext-lmnet:published, paper" in found.pace_from
    bucket = str(tmp_path / "logs")
    assert main(["run", "--dry-run", "--bucket", bucket, "--supervised", "recorded"]) == 0
    assert "no estimate of the time" in capsys.readouterr().err
    ahead = dry_run(tmp_path, selfsupervised="registration:lookahead-0.5")
    assert ahead.seconds_per_frame == DEFAULT_SECONDS_PER_FRAME


def recordings_in(folder: Path) -> list[Recording]:
    return group_recordings(open_bucket(str(folder / "logs")).list())


def mine(folder: Path, version: str, *, until: int = 100, layers: Layers | None = None) -> None:
    """Mine the bucket in three shards a log, so many of them, as `refused` and `parked` say."""
    request = ClaimRequest(worker_id="w1", pipeline_version=version, layers=layers)
    (folder / "state").mkdir(exist_ok=True)
    with closing(open_store(folder / "state")) as store:
        world = World.on(store)
        world.ledger.sync_recordings(recordings_in(folder))
        while until and isinstance(
            lease := world.ledger.claim(request).grant, PlanLease | MineLease
        ):
            log_id = lease.recording.log_id
            if isinstance(lease, PlanLease):
                refused = "no lidar" if log_id.startswith("refused") else ""
                assert world.commit_plan(lease, plan=plan_of(log_id, refused=refused)).ok
            elif log_id.startswith("parked") and lease.shard.index == 1:
                assert world.fail(lease, permanent=True).ok
            else:
                assert world.commit_shard(lease, version=version).ok
                until -= 1
        world.ledger.free_leases("w1")


def logs_of(folder: Path, *names: str, seconds: int = 1) -> None:
    (folder / "logs").mkdir(exist_ok=True)
    for name in names:
        (folder / "logs" / f"{name}.mcap").write_bytes(Recorder().write(drive(seconds)))


def standings(found: DryRun) -> dict[str, str]:
    return {log.log_id: log.standing for log in found.logs}


@pytest.fixture(scope="module")
def version() -> str:
    return version_of(load_settings(bucket="logs").mining())


def test_what_is_mined_already_counts_no_hours(tmp_path: Path, version: str) -> None:
    logs_of(tmp_path, "done", "parked", "refused")
    mine(tmp_path, version)
    found = dry_run(tmp_path)
    assert standings(found) == {"done": "mined", "parked": "mined", "refused": "refused"}
    assert [log.parked for log in found.logs] == [0, 1, 0]
    assert [log.frames for log in found.logs] == [180, 120, 0]
    assert (found.left_bytes, found.looked_into, found.frames, found.hours) == (0, 0, 0, 0)
    assert found.pipeline_version == found.state_version == version
    logs_of(tmp_path, "late", seconds=2)
    found = dry_run(tmp_path)
    assert standings(found)["late"] == "new"
    assert (found.looked_into, found.frames) == (1, 20)
    assert found.left_bytes == next(log.bytes for log in found.logs if log.log_id == "late")


def test_of_a_log_that_is_mined_in_part_the_rest_counts(tmp_path: Path, version: str) -> None:
    logs_of(tmp_path, "half", seconds=3)
    mine(tmp_path, version, until=2)
    found = dry_run(tmp_path)
    (log,) = found.logs
    assert log.standing == "in part"
    assert log.left_share == pytest.approx(1 / 3)
    assert (log.frames, found.frames) == (30, 10)
    assert found.duration_s == pytest.approx(2.9 / 3, abs=0.05)


def test_another_pipeline_version_mines_everything_anew(tmp_path: Path, version: str) -> None:
    logs_of(tmp_path, "done", "refused")
    mine(tmp_path, "an older one")
    logs_of(tmp_path, "late")
    found = dry_run(tmp_path)
    assert standings(found) == {"done": "anew", "late": "new", "refused": "new"}
    assert found.by_standing == {"anew": 1, "new": 2}
    assert (found.pipeline_version, found.state_version) == (version, "an older one")
    assert found.frames == 30
    mine(tmp_path, version, until=1)  # it has begun with what is new, and all plans are made
    assert standings(dry_run(tmp_path)) == {"done": "anew", "late": "in part", "refused": "refused"}
    other = dry_run(tmp_path, grid={"shard_s": 10})
    assert standings(other)["done"] == "anew"
    assert other.pipeline_version not in (version, "an older one")


def test_where_the_score_alone_changed_no_frame_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mining = load_settings(bucket="logs").mining()
    ours = layers_of(mining, parts_of(mining))
    stated = Layers(**asdict(ours))
    logs_of(tmp_path, "done", "parked", "refused")
    mine(tmp_path, "former", layers=stated.model_copy(update={"score": "of before"}))
    found = dry_run(tmp_path)
    assert standings(found) == {"done": "scores", "parked": "in part", "refused": "refused"}
    assert [log.left_share for log in found.logs] == [0.0, pytest.approx(1 / 3), 0.0]
    bucket, state = str(tmp_path / "logs"), str(tmp_path / "state")
    assert main(["run", "--dry-run", "--bucket", bucket, "--state", state]) == 0
    assert "scores of 1 log are computed again" in capsys.readouterr().err
    mine(tmp_path, ours.pipeline_version, layers=stated, until=1)
    assert standings(dry_run(tmp_path))["done"] == "scores", "begun under the new one"


def test_a_state_that_is_not_up_to_date_is_said_to_be_left_out(
    tmp_path: Path, version: str, capsys: pytest.CaptureFixture[str]
) -> None:
    logs_of(tmp_path, "done")
    mine(tmp_path, version)
    assert dry_run(tmp_path).not_compared == ""
    with closing(sqlite3.connect(tmp_path / "state" / DATABASE_NAME)) as older, older:
        older.execute("DELETE FROM schema_version WHERE version > 1")
    found = dry_run(tmp_path)
    assert (standings(found), found.pipeline_version) == ({"done": "new"}, "")
    assert "bring it up to date" in found.not_compared
    bucket, state = str(tmp_path / "logs"), str(tmp_path / "state")
    assert main(["run", "--dry-run", "--bucket", bucket, "--state", state]) == 0
    assert "not compared with the state, so that all counts as left" in capsys.readouterr().err


def test_a_log_whose_objects_changed_is_left(tmp_path: Path, version: str) -> None:
    logs_of(tmp_path, "grown")
    mine(tmp_path, version)
    before = (tmp_path / "logs" / "grown.mcap").read_bytes()
    logs_of(tmp_path, "grown", seconds=2)
    found = dry_run(tmp_path)
    assert (standings(found), found.frames) == ({"grown": "changed"}, 20)
    (tmp_path / "logs" / "grown.mcap").write_bytes(before)
    os.utime(tmp_path / "logs" / "grown.mcap", ns=(1, 1))
    assert standings(dry_run(tmp_path)) == {"grown": "changed"}, "another etag in a folder"


def test_a_log_that_is_back_as_it_was_is_not_mined_again(tmp_path: Path, version: str) -> None:
    logs_of(tmp_path, "a", "b")
    mine(tmp_path, version)
    away = (tmp_path / "logs" / "b.mcap").rename(tmp_path / "b.mcap")
    mine(tmp_path, version)
    away.rename(tmp_path / "logs" / "b.mcap")
    assert standings(dry_run(tmp_path)) == {"a": "mined", "b": "mined"}


def test_a_state_of_another_bucket_is_refused_as_a_run_would(tmp_path: Path, version: str) -> None:
    logs = bucket_of(tmp_path, (1,))
    mine(tmp_path, version)
    with closing(open_store(tmp_path / "state")) as store, store.writing() as connection:
        note_served(connection, logs.as_uri())
    assert dry_run(tmp_path).by_standing == {"mined": 1}
    elsewhere = bucket_of(tmp_path / "elsewhere", (2,))
    settings = load_settings(bucket=str(elsewhere), state=tmp_path / "state")
    with pytest.raises(OtherBucketError, match=r"of its 1 logs .*/elsewhere/logs holds 0"):
        plan_dry_run(settings)


def test_without_a_state_all_is_left(tmp_path: Path) -> None:
    logs_of(tmp_path, "a")
    found = dry_run(tmp_path)
    assert found.logs[0] == DryLog(
        log_id="a", parts=1, bytes=found.bytes, duration_s=0.9, frames=10
    )
    assert (found.left_bytes, found.pipeline_version) == (found.bytes, "")
    assert not (tmp_path / "state").exists()


def test_the_verb_says_what_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], version: str
) -> None:
    logs_of(tmp_path, "done", "parked")
    mine(tmp_path, version)
    at = ["--bucket", str(tmp_path / "logs"), "--state", str(tmp_path / "state"), "--dry-run"]
    assert main(["run", *at]) == 0
    told = capsys.readouterr().err
    assert f"under pipeline version {version} the state has: 2 mined" in told
    assert "left to mine: 0 logs" in told
    assert "1 plans and shards are parked, and not counted: `counterpoint retry`" in told
    logs_of(tmp_path, "late")
    assert main(["run", *at, "--shard-seconds", "10"]) == 0
    told = capsys.readouterr().err
    assert "the state has: 2 anew, 1 new" in told
    assert f"version in the state is another, {version}" in told
    assert "left: about 30 frames" in told


def test_the_verb_prints_a_table_or_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    bucket_of(tmp_path, (1,))
    assert main(["run", "--bucket", "logs", "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 10
    assert main(["run", "--bucket", "logs", "--dry-run"]) == 0
    told = capsys.readouterr()
    assert "car-0/today/drive" in told.out
    assert "about 10 frames" in told.err
    assert main(["run", "--bucket", "logs", "--json"]) == 1


def test_a_damaged_state_is_refused_and_not_taken_for_an_empty_one(tmp_path: Path) -> None:
    logs_of(tmp_path, "a")
    (tmp_path / "state").mkdir()
    (tmp_path / "state" / "counterpoint.sqlite").write_bytes(b"not a database" * 400)
    with pytest.raises(StateUnusableError, match="damaged"):
        dry_run(tmp_path)


def test_a_state_that_is_a_file_is_refused(tmp_path: Path) -> None:
    logs_of(tmp_path, "a")
    (tmp_path / "state").write_text("notes")
    with pytest.raises(StateUnusableError, match="a file, not a folder"):
        dry_run(tmp_path)
