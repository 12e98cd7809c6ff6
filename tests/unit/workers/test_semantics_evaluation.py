import json
from pathlib import Path

import numpy as np
import pytest

from schemas.mining import Grid, MiningSettings
from service.cli.main import main
from tests.factories import street_log
from workers.errors import UnknownPartError
from workers.lab.evaluation.semantics.semantics import evaluate_semantics
from workers.lab.evaluation.truth.class_table import COARSE, coarse_of_ids, coarse_of_names
from workers.lab.evaluation.truth.truth import TruthUnusableError


def test_classes_of_data_sets_and_networks_meet_in_coarse_ones() -> None:
    names = ("unlabeled", "car", "bicyclist", "trunk", "terrain", "traffic_facility", "spaceship")
    found = [COARSE[each] for each in coarse_of_names(names)]
    assert found == [
        *("none", "car", "two_wheeler", "vegetation", "other_ground", "traffic_facility", "none")
    ]


def test_ids_mean_what_the_nearest_table_above_the_truth_says(tmp_path: Path) -> None:
    log = tmp_path / "car-7" / "drive"
    log.mkdir(parents=True)
    table = {"classes": [{"id": 200, "semantickitti19": 6}, {"id": 7, "semantickitti19": 0}]}
    (tmp_path / "classes.json").write_text(json.dumps(table))
    ids = coarse_of_ids(log)
    assert ids is not None
    assert (COARSE[ids[200]], COARSE[ids[7]], COARSE[ids[9]]) == ("pedestrian", "none", "none")


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log whose recorded labels are its truth."""
    folder = tmp_path_factory.mktemp("fleet")
    street_log(folder / "logs" / "drive.mcap", frames=4, truth=folder / "truth" / "drive")
    return folder


def _settings(fleet: Path, **parts: str) -> MiningSettings:
    grid = Grid(shard_s=3600.0, warmup_s=0.0)
    logs = str(fleet / "logs")
    return MiningSettings(bucket=logs, artifacts="memory://", grid=grid, **parts)


def test_what_is_recorded_right_has_an_iou_of_one_in_every_class(fleet: Path) -> None:
    settings = _settings(fleet, supervised="recorded")
    (row, total) = evaluate_semantics(
        settings.bucket, fleet / "truth", frames=range(1, 3), settings=settings
    )
    assert (row.log, total.log) == ("drive", "all")
    assert row.frames == total.frames == 2
    assert {"road", "car", "building"} <= set(row.iou)
    assert set(row.iou.values()) == {1.0}
    assert row.miou == row.movable_iou == 1.0
    assert row.unanswered_share == 0.0


def test_what_is_recorded_is_read_when_it_is_asked_for_by_name(fleet: Path) -> None:
    settings = _settings(fleet)
    (row, _) = evaluate_semantics(
        settings.bucket, fleet / "truth", frames=range(1, 3), settings=settings, stream="recorded"
    )
    assert row.miou == 1.0
    assert row.unanswered_share == 0.0


def test_a_network_that_never_saw_such_a_street_is_counted_point_by_point(fleet: Path) -> None:
    settings = _settings(fleet)
    (row, _) = evaluate_semantics(settings.bucket, fleet / "truth", settings=settings)
    assert row.frames == 4
    assert row.miou is not None
    assert 0 < row.miou < 1
    assert np.isclose(row.miou, np.mean(list(row.iou.values())), atol=1e-3)


def test_streams_without_classes_and_logs_without_truth_are_refused(
    fleet: Path, tmp_path: Path
) -> None:
    settings = _settings(fleet)
    with pytest.raises(UnknownPartError, match="has no classes"):
        evaluate_semantics(
            settings.bucket, fleet / "truth", settings=settings, stream="registration"
        )
    with pytest.raises(TruthUnusableError, match=r"no log of .* has semantic truth"):
        evaluate_semantics(settings.bucket, tmp_path, settings=settings)


def test_the_command_prints_a_table_or_json(
    fleet: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["eval", "semantics", str(fleet / "logs"), "--truth", str(fleet / "truth")]
    assert main([*arguments, "--frames", "0:2", "--stream", "recorded"]) == 0
    said = capsys.readouterr().out
    assert "all movable classes" in said
    assert "supervised stream recorded" in said
    assert main([*arguments, "--frames", "0:2", "--stream", "recorded", "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["log"] for row in rows] == ["drive", "all"]
