"""A dry run lists what would be mined, estimates by bytes what it did not open, writes nothing."""

import json
import os
from collections.abc import Sequence
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from schemas.work import MiningStats
from service.cli.main import main
from service.config import load_settings
from service.dry_run import DEFAULT_SECONDS_PER_FRAME, MOST_LOOKED_INTO, DryRun, plan_dry_run
from service.errors import NothingFoundError
from service.store.engine import open_store
from tests.contracts.ledger_world import World, mined, shard_commit
from tests.tiny_logs import Recorder, drive


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
