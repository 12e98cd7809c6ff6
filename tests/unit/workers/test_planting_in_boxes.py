"""Failures planted into the boxes of a detector that are made from the truth of a drive."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap_ros2.writer import Writer
from numpy.typing import NDArray

from schemas.predicted_boxes import SCHEMA_NAME, PredictedBoxes
from schemas.transport.bucket import open_bucket
from tests.unit.workers.bare_drive import (
    FRAMES,
    IDENTITY,
    KEY,
    LIDAR,
    bytes_of,
    drive_of,
    settings_of,
    write_bare_log,
)
from workers.ingest.read import read_shard
from workers.lab.evaluation.failures.bench import jobs_of
from workers.lab.evaluation.failures.planting.bench import bench_planting
from workers.lab.evaluation.failures.planting.boxes import boxes_of_variant, messages_of_variant
from workers.lab.evaluation.failures.planting.drive import Drive, DriveFrame, FrameRange
from workers.lab.evaluation.failures.planting.mine_variant import mine_answers
from workers.lab.evaluation.failures.planting.true_boxes import boxes_of_frame
from workers.lab.evaluation.failures.planting.variants import (
    Answer,
    Planting,
    Variant,
    place_failures,
)
from workers.lab.evaluation.truth.truth import LogTruth, TruthUnusableError
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.lab.labels.noise_settings import REAL
from workers.lab.simulation.faults.detected_boxes import Body
from workers.lab.simulation.faults.plan import FailureKind
from workers.lab.simulation.faults.recorded import recorded_classes
from workers.lab.simulation.output.box_messages import BOXES_TOPIC
from workers.lab.simulation.output.cloud import (
    POINT_CLOUD2,
    POINT_CLOUD2_DEFINITION,
    cloud_of,
    message_of,
)
from workers.lab.simulation.sensor.lidar import sweep
from workers.lab.simulation.world.street_builder import build_street
from workers.parts.protocols import Parts
from workers.pipeline import mine_shard
from workers.points.se3 import inverse
from workers.version import parts_of

TWO_FAILURES = Variant(
    number=3,
    seed=11,
    frames=FrameRange(),
    noise=REAL,
    planned=((0, FailureKind.PARKED_CALLED_MOVING), (1, FailureKind.MISSED_MOVER)),
    answer=Answer.BOXES,
)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One log of two scenes, without recorded answers, and its truth."""
    folder = tmp_path_factory.mktemp("fleet")
    write_bare_log(folder)
    return folder


@pytest.fixture(scope="module")
def parts(fleet: Path) -> Parts:
    return parts_of(settings_of(fleet))


@pytest.fixture(scope="module")
def drive(fleet: Path, parts: Parts) -> Drive:
    return drive_of(fleet, parts)


def write_log(path: Path, drive: Drive, messages: list[bytes]) -> None:
    """Write the street of the drive again, with these messages of boxes."""
    street = build_street(4, seconds=FRAMES * LIDAR.period_s, style="drives")
    path.parent.mkdir(parents=True)
    with path.open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef(POINT_CLOUD2, POINT_CLOUD2_DEFINITION)
        writer.add_metadata("counterpoint.classes", recorded_classes())
        writer.add_metadata("counterpoint.log", IDENTITY)
        published = json.dumps(PredictedBoxes.model_json_schema()).encode()
        mcap = writer._writer
        of_boxes = mcap.register_schema(name=SCHEMA_NAME, encoding="jsonschema", data=published)
        channel = mcap.register_channel(
            topic=BOXES_TOPIC, message_encoding="json", schema_id=of_boxes
        )
        for index, data in enumerate(messages):
            stamp_ns = drive.frames[index].posed.frame.stamp_ns
            cloud = cloud_of(sweep(street, LIDAR, index), None)
            message = message_of(cloud, stamp_ns=stamp_ns, space="lidar_top")
            writer.write_message("/lidar/top/points", schema, message, stamp_ns, stamp_ns, index)
            mcap.add_message(
                channel_id=channel, log_time=stamp_ns, publish_time=stamp_ns, data=data
            )
        writer.finish()  # type: ignore[no-untyped-call]  # upstream lacks the return type


def test_a_variant_equals_a_log_that_contains_its_boxes(
    fleet: Path, drive: Drive, parts: Parts, tmp_path: Path
) -> None:
    failures = place_failures(drive, TWO_FAILURES)
    assert len(failures) == 2
    boxes = boxes_of_variant(drive, TWO_FAILURES, failures)
    replayed = [
        bytes_of(mined, parts) for mined in mine_answers(drive, boxes, parts, pipeline_version="0")
    ]
    messages = list(messages_of_variant(drive, TWO_FAILURES, failures))
    write_log(tmp_path / f"{KEY}.mcap", drive, messages)

    bucket = open_bucket(str(tmp_path))
    recording = jobs_of(str(tmp_path), fleet / "truth")[0].recording
    settings = settings_of(fleet)
    (shard,) = shards_of_log(bucket, recording, settings)
    assert shard.recorded is not None
    assert shard.recorded.boxes is not None
    frames = read_shard(bucket, recording, shard, settings).frames()
    of_log = parts_of(settings)
    mined = mine_shard(shard, frames, of_log, pipeline_version="0")
    assert [bytes_of(each, of_log) for each in mined] == replayed
    assert len(replayed) == 2


def test_true_boxes_contain_the_points_of_their_objects(drive: Drive) -> None:
    shares = []
    for frame in drive.frames:
        pose = frame.world_from_sensor
        world = frame.points_m @ pose[:3, :3].T + pose[:3, 3]
        for track, body in frame.bodies.items():
            mine = (frame.track == track) & (frame.ground == 0)
            along = np.array([np.cos(body.yaw_rad), np.sin(body.yaw_rad)])
            away = world[mine] - body.centre_m
            across = np.array([-along[1], along[0]])
            offsets = np.stack([away[:, :2] @ along, away[:, :2] @ across, away[:, 2]], axis=1)
            shares.append(float((np.abs(offsets) < body.size_m / 2 + 0.15).all(axis=1).mean()))
    assert len(shares) > 100
    assert np.median(shares) > 0.95


def box_of_shifted(fleet: Path, frame: DriveFrame, track: int, shift_m: float) -> Body:
    """Return the true box of an object whose points lie along its length, shifted ahead."""
    truth = LogTruth.beside(
        jobs_of(str(fleet / "logs"), fleet / "truth")[0].recording, fleet / "truth"
    )
    assert truth is not None
    body, mine = frame.bodies[track], frame.track == track
    reach_m = np.linspace(-0.5, 0.5, int(mine.sum())) * body.size_m[0] + shift_m
    places = body.centre_m + reach_m[:, None] * ahead_of(body)
    sensor_from_odom = inverse(frame.posed.odom_from_sensor)
    points = frame.posed.frame.points_m.copy()
    points[mine] = places @ sensor_from_odom[:3, :3].T + sensor_from_odom[:3, 3]
    posed = replace(frame.posed, frame=replace(frame.posed.frame, points_m=points))
    return boxes_of_frame(truth, frame.truth.number, posed, frame.track)[track]


def ahead_of(body: Body) -> NDArray[np.float64]:
    return np.array([np.cos(body.yaw_rad), np.sin(body.yaw_rad), 0.0])


@pytest.mark.parametrize("shift_m", [0.4, -0.4, 0.0])
def test_a_box_that_lags_is_moved_onto_its_object(
    fleet: Path, drive: Drive, shift_m: float
) -> None:
    frame, track = seen_body(drive, least_mps=5.0, most_mps=30.0)
    moved = box_of_shifted(fleet, frame, track, shift_m)
    unmoved = box_of_shifted(fleet, frame, track, 0.0)
    way = moved.centre_m - unmoved.centre_m
    assert way @ ahead_of(unmoved) == pytest.approx(shift_m, abs=0.25 if shift_m else 1e-9)
    assert np.linalg.norm(way) == pytest.approx(abs(way @ ahead_of(unmoved)), abs=1e-9)


def test_a_box_moves_no_farther_than_its_object_drives_in_a_sweep(
    fleet: Path, drive: Drive
) -> None:
    for least_mps, most_mps in ((5.0, 30.0), (0.0, 0.01)):
        frame, track = seen_body(drive, least_mps=least_mps, most_mps=most_mps)
        unmoved = box_of_shifted(fleet, frame, track, 0.0)
        way = box_of_shifted(fleet, frame, track, 9.0).centre_m - unmoved.centre_m
        sweep_m = 0.1 * np.hypot(*unmoved.velocity)
        assert np.linalg.norm(way) == pytest.approx(sweep_m, abs=0.05)


def seen_body(drive: Drive, *, least_mps: float, most_mps: float) -> tuple[DriveFrame, int]:
    """Return a frame and an object in it with many points and a speed in this range."""
    return next(
        (frame, track)
        for frame in drive.frames
        for track, body in frame.bodies.items()
        if least_mps <= np.hypot(*body.velocity) <= most_mps and (frame.track == track).sum() >= 40
    )


def test_planted_failures_are_missing_boxes_and_invented_velocities(drive: Drive) -> None:
    (parked, missed) = place_failures(drive, TWO_FAILURES)
    found = list(boxes_of_variant(drive, TWO_FAILURES, [parked, missed]))
    plain = list(boxes_of_variant(drive, TWO_FAILURES, []))
    assert len(found) == len(plain) == FRAMES
    for frame, changed, right in zip(drive.frames, found, plain, strict=True):
        assert changed is not None
        assert right is not None
        assert len(right) - len(changed) in ((0, 1) if missed.is_on(frame.time_s) else (0,))
        if parked.is_on(frame.time_s):
            speed, usual = (
                np.linalg.norm(each.velocity_m_per_s[:, :2], axis=1) for each in (changed, right)
            )
            assert (speed > 1.2).sum() == (usual > 1.2).sum() + 1
    lost = [
        len(right) - len(changed)
        for frame, changed, right in zip(drive.frames, found, plain, strict=True)
        if missed.is_on(frame.time_s) and changed is not None and right is not None
    ]
    assert sum(lost) >= len(lost) / 2


def test_boxes_are_mined_ranked_and_listed(fleet: Path) -> None:
    made, planted = bench_planting(
        str(fleet / "logs"),
        fleet / "truth",
        settings_of(fleet),
        Planting(variants=2, share=0.25, answer=Answer.BOXES),
        processes=1,
        kept=None,
        draws=10,
    )
    assert (made.answer, planted.answer) == ("boxes", Answer.BOXES)
    assert made.planted is not None
    assert (made.planted.scenes, made.planted.planted) == (4, 1)


def test_truth_without_boxes_is_refused_in_one_sentence(fleet: Path, tmp_path: Path) -> None:
    folder = tmp_path / KEY
    folder.mkdir(parents=True)
    for file in sorted((fleet / "truth" / KEY).glob("*.npz")):
        (folder / file.name).symlink_to(file)
    with pytest.raises(TruthUnusableError, match=r"no boxes; --answer boxes needs tracks\.csv"):
        bench_planting(
            str(fleet / "logs"),
            tmp_path,
            settings_of(fleet),
            Planting(variants=1, answer=Answer.BOXES),
            processes=1,
            kept=None,
        )
