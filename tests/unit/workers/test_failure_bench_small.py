from pathlib import Path

import pytest

from schemas.mining import MiningSettings
from tests.factories import missed_and_phantom, street_log
from workers.lab.evaluation.failures.bench import FailureBench, bench_failures
from workers.lab.evaluation.failures.uncertainty import NO_PROBING
from workers.lab.evaluation.truth.truth import TruthUnusableError
from workers.lab.simulation.sensor.lidar import UNEVEN_64, Lidar
from workers.lab.simulation.world.street_builder import build_street

FRAMES = 40
KEY = "car-7/2026-03-02/drive"


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One log of two scenes whose model errs on many things, all the time."""
    folder = tmp_path_factory.mktemp("fleet")
    street_log(
        folder / "logs" / f"{KEY}.mcap",
        frames=FRAMES,
        seed=4,
        lidar=Lidar(elevation_deg=UNEVEN_64[::2], columns=256),
        failures=missed_and_phantom(build_street(4, seconds=4.0, style="drives")).failures,
        truth=folder / "truth" / KEY,
    )
    return folder


def bench(fleet: Path, table: str, kept: Path | None = None) -> tuple[FailureBench, list[int]]:
    told: list[int] = []
    made = bench_failures(
        str(fleet / "logs"),
        fleet / "truth",
        MiningSettings(bucket=str(fleet / "logs"), artifacts="memory://", supervised="recorded"),
        tables=(table,),
        processes=1,
        kept=kept,
        probing=NO_PROBING,
        draws=10,
        on_progress=lambda done, total: told.append(done),
    )
    return made, told


def test_what_was_planted_is_mined_judged_and_kept(fleet: Path, tmp_path: Path) -> None:
    made, told = bench(fleet, "planted", tmp_path)
    assert told == [0, FRAMES]
    table = made.planted
    assert table is not None
    assert made.natural is None
    assert made.judged == {"planted": "recorded"}
    assert (table.scenes, table.failing_scenes) == (2, 2)
    assert table.failures >= 2
    assert set(table.kinds) <= {"missed_mover", "parked_called_moving"}
    assert table.attribution.cases["supervised"] > 0
    again, _ = bench(fleet, "planted", tmp_path)
    assert again == made


def test_things_are_ranked_whatever_said_the_labels(fleet: Path) -> None:
    made, _ = bench(fleet, "natural")
    assert made.judged == {"natural": "recorded"}
    table = made.natural
    assert table is not None
    assert 0 < table.failing_things < table.things
    assert {"random", "confidence", "flicker", "point_share"} <= set(table.baselines)
    assert table.ap is not None
    assert table.ap > table.failing_things / table.things


def test_nothing_planted_is_no_table(fleet: Path, tmp_path: Path) -> None:
    street_log(tmp_path / "logs" / f"{KEY}.mcap", frames=3, truth=tmp_path / "truth" / KEY)
    (tmp_path / "truth" / KEY / "planted.json").unlink()
    with pytest.raises(TruthUnusableError, match="nothing was planted"):
        bench(tmp_path, "planted")
