"""Failures planted into labels that are made from the truth of a drive."""

from pathlib import Path

import pytest
from mcap_ros2.writer import Writer

from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.overlay_codec import encode_overlay
from schemas.transport.wire import encode_scene_score
from tests.factories import street_log
from workers.contradiction.overlay import overlay_of
from workers.ingest.read import read_shard
from workers.lab.evaluation.failures.bench import jobs_of
from workers.lab.evaluation.failures.planting.drive import Drive, FrameRange, load_drive
from workers.lab.evaluation.failures.planting.labels import labels_of_variant
from workers.lab.evaluation.failures.planting.mine_variant import mine_labels
from workers.lab.evaluation.failures.planting.variants import (
    Variant,
    place_failures,
)
from workers.lab.evaluation.truth.truth import LogTruth
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.lab.labels.noise import REAL
from workers.lab.simulation.faults.plan import FailureKind
from workers.lab.simulation.faults.recorded import RecordedPoints, recorded_classes
from workers.lab.simulation.output.cloud import (
    POINT_CLOUD2,
    POINT_CLOUD2_DEFINITION,
    cloud_of,
    labels_of,
    message_of,
)
from workers.lab.simulation.sensor.lidar import UNEVEN_64, Lidar, sweep
from workers.lab.simulation.world.street_builder import build_street
from workers.parts.protocols import Parts
from workers.pipeline import MinedScene, mine_shard
from workers.version import parts_of

FRAMES = 40
KEY = "car-7/2026-03-02/drive"
LIDAR = Lidar(elevation_deg=UNEVEN_64[::2], columns=256)
IDENTITY = {"vehicle": "sim-01", "date": "2026-03-02", "software_version": "2026.1"}
TWO_FAILURES = Variant(
    number=3,
    seed=11,
    frames=FrameRange(),
    noise=REAL,
    planned=((0, FailureKind.PARKED_CALLED_MOVING), (1, FailureKind.MISSED_MOVER)),
)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One log of two scenes, without recorded labels, and its truth without `planted.json`."""
    folder = tmp_path_factory.mktemp("fleet")
    street_log(
        folder / "logs" / f"{KEY}.mcap",
        frames=FRAMES,
        seed=4,
        lidar=LIDAR,
        recorded_as="nothing",
        truth=folder / "truth" / KEY,
    )
    (folder / "truth" / KEY / "planted.json").unlink()
    return folder


@pytest.fixture(scope="module")
def parts(fleet: Path) -> Parts:
    return parts_of(settings_of(fleet))


@pytest.fixture(scope="module")
def drive(fleet: Path, parts: Parts) -> Drive:
    bucket = open_bucket(str(fleet / "logs"))
    recording = jobs_of(str(fleet / "logs"), fleet / "truth")[0].recording
    truth = LogTruth.beside(recording, fleet / "truth")
    assert truth is not None
    return load_drive(bucket, recording, truth, settings_of(fleet), parts, frames=FrameRange())


def settings_of(fleet: Path) -> MiningSettings:
    return MiningSettings(bucket=str(fleet / "logs"), artifacts="memory://", supervised="recorded")


def bytes_of(mined: MinedScene, parts: Parts) -> tuple[bytes, bytes]:
    names = parts.supervised.class_names
    overlay = overlay_of(mined.scene, mined.instances, mined.tracks, class_names=names)
    return encode_scene_score(mined.score), encode_overlay(overlay)


def test_a_variant_equals_a_log_that_contains_its_labels(
    fleet: Path, drive: Drive, parts: Parts, tmp_path: Path
) -> None:
    failures = place_failures(drive, TWO_FAILURES)
    assert len(failures) == 2
    labels = list(labels_of_variant(drive, TWO_FAILURES, failures))
    replayed = [
        bytes_of(mined, parts) for mined in mine_labels(drive, labels, parts, pipeline_version="0")
    ]

    street = build_street(4, seconds=FRAMES * LIDAR.period_s, style="drives")
    path = tmp_path / f"{KEY}.mcap"
    path.parent.mkdir(parents=True)
    with path.open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef(POINT_CLOUD2, POINT_CLOUD2_DEFINITION)
        writer.add_metadata("counterpoint.classes", recorded_classes())
        writer.add_metadata("counterpoint.log", IDENTITY)
        for index, recorded in enumerate(labels):
            stamp_ns = drive.frames[index].posed.frame.stamp_ns
            assert recorded.motion is not None
            assert recorded.confidence is not None
            points = RecordedPoints(recorded.class_id, recorded.motion, recorded.confidence)
            clouds = cloud_of(sweep(street, LIDAR, index), None)
            for topic, rows in (
                ("/lidar/top/points", clouds),
                ("/lidar/labels", labels_of(points)),
            ):
                message = message_of(rows, stamp_ns=stamp_ns, space="lidar_top")
                writer.write_message(topic, schema, message, stamp_ns, stamp_ns, index)
        writer.finish()
    bucket = open_bucket(str(tmp_path))
    recording = jobs_of(str(tmp_path), fleet / "truth")[0].recording
    settings = settings_of(fleet)
    (shard,) = shards_of_log(bucket, recording, settings)
    assert shard.recorded is not None
    frames = read_shard(bucket, recording, shard, settings).frames()
    mined = mine_shard(shard, frames, parts_of(settings), pipeline_version="0")
    assert [bytes_of(each, parts) for each in mined] == replayed
    assert len(replayed) == 2
