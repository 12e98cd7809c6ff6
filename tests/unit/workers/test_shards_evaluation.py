import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from schemas.mining import Grid, MiningSettings
from service.cli.main import main
from tests.factories import SMALL_LIDAR, street_log
from workers.lab.evaluation.motion.shard_consistency import NoShardsError, evaluate_shards


def mining(bucket: Path, *, shard_s: float, warmup_s: float) -> MiningSettings:
    grid = Grid(shard_s=shard_s, warmup_s=warmup_s)
    return MiningSettings(bucket=str(bucket), artifacts="memory://", grid=grid)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of six seconds."""
    folder = tmp_path_factory.mktemp("shards")
    beams = tuple(np.linspace(3.0, -24.0, 32).tolist())
    lidar = replace(SMALL_LIDAR, elevation_deg=beams, columns=600)
    street_log(folder / "drive.mcap", frames=60, lidar=lidar)
    return folder


def test_with_a_long_warm_up_shards_say_what_the_whole_log_says(
    logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--shard-seconds", "4", "--warmup-seconds", "4.7", "--json"]
    assert main(["eval", "shards", str(logs), *flags]) == 0
    row, total = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert (row["log"], row["shards"], total["log"]) == ("drive", 2, "all")
    assert row["points"] == total["points"] > 60 * 10_000
    assert row["equal_share"] > 0.9999
    assert list(row["equal_by_second"]) == ["0", "1"]
    assert row["equal_by_second"]["1"] > 0.9999


def test_without_any_the_first_seconds_of_a_window_differ(logs: Path) -> None:
    row, _ = evaluate_shards(str(logs), settings=mining(logs, shard_s=4.0, warmup_s=0.0))
    assert row.equal_by_second["0"] < 0.995
    assert row.equal_by_second["1"] > row.equal_by_second["0"]
    assert row.equal_share < 1.0


def test_a_log_that_is_not_cut_says_nothing(logs: Path) -> None:
    with pytest.raises(NoShardsError, match="longer than a shard"):
        evaluate_shards(str(logs), settings=mining(logs, shard_s=20.0, warmup_s=1.2))
