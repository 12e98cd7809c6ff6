"""The pipeline version: changes with everything that may change a record, and nothing else."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import pytest

from schemas.errors import PermanentError
from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameLabels
from schemas.mining import Grid, MiningSettings
from schemas.task import MOTION, Task
from workers.parts.protocols import Parts
from workers.version import NOT_IN_VERSION, parts_of, pipeline_version


@dataclass(frozen=True)
class NamedOdometry:
    version: str

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        raise AssertionError("a version is known without running anything")


@dataclass(frozen=True)
class NamedStream:
    version: str
    class_names: tuple[str, ...] = ()
    task: Task = MOTION

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        raise AssertionError("a version is known without running anything")


PARTS = Parts(NamedOdometry("o@1"), NamedStream("s@1"), NamedStream("p@1"))
SETTINGS = MiningSettings(bucket="s3://fleet", artifacts="s3://overlays")
CHANGED = {
    "grid": Grid(shard_s=2.0),
    "supervised": "recorded",
    "selfsupervised": "two-stage",
    "motion_rule": "{}",
    "odometry": "other",
    "lidar_topic": "/lidar/left",
    "odometry_topic": "/odom",
    "place_topic": "/gps/fix",
    "recorded_topic": "/objects",
    "predictions": "s3://answers/run-2",
    "path_template": "{date}/{name}",
    "stamp_at": "end",
    "compensated": "yes",
    "camera": "recorded",
    "instances": "paper",
    "witness": "none",
    "intensity_scale": 255.0,
}


def test_where_logs_lie_and_overlays_go_does_not_matter() -> None:
    elsewhere = SETTINGS.model_copy(update={"bucket": "gs://b", "artifacts": "file:///tmp/a"})
    assert pipeline_version(elsewhere, PARTS) == pipeline_version(SETTINGS, PARTS)


@pytest.mark.parametrize("name", CHANGED)
def test_every_other_setting_makes_another_version(name: str) -> None:
    changed = SETTINGS.model_copy(update={name: CHANGED[name]})
    assert pipeline_version(changed, PARTS) != pipeline_version(SETTINGS, PARTS)


def test_every_setting_is_known_to_matter_or_not() -> None:
    assert set(MiningSettings.model_fields) == set(CHANGED) | NOT_IN_VERSION


def test_new_weights_in_any_part_make_another_version() -> None:
    versions = {
        pipeline_version(SETTINGS, parts)
        for parts in (
            PARTS,
            replace(PARTS, odometry=NamedOdometry("o@2")),
            replace(PARTS, supervised=NamedStream("s@2")),
            replace(PARTS, selfsupervised=NamedStream("p@2")),
        )
    }
    assert len(versions) == 4


def test_a_part_that_does_not_exist_is_named_with_those_that_do() -> None:
    with pytest.raises(PermanentError, match=r"'oracle'.*recorded"):
        parts_of(SETTINGS.model_copy(update={"supervised": "oracle"}))
