"""Failures planted into labels that are made from the truth of a drive."""

from pathlib import Path

import numpy as np
import pytest
from mcap_ros2.writer import Writer

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
from workers.lab.evaluation.failures.bench import FailureBench, jobs_of
from workers.lab.evaluation.failures.planting.bench import bench_planting
from workers.lab.evaluation.failures.planting.drive import Drive, FrameRange
from workers.lab.evaluation.failures.planting.labels import labels_of_variant
from workers.lab.evaluation.failures.planting.load_drive import load_drive
from workers.lab.evaluation.failures.planting.mine_variant import mine_answers
from workers.lab.evaluation.failures.planting.planted_file import PlantedFile
from workers.lab.evaluation.failures.planting.variants import (
    Planting,
    Variant,
    place_failures,
    plan_variants,
)
from workers.lab.evaluation.truth.truth import LogTruth, TruthUnusableError
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.lab.labels.noise_settings import REAL
from workers.lab.simulation.faults.plan import FailureKind
from workers.lab.simulation.faults.recorded import RecordedPoints, recorded_classes
from workers.lab.simulation.output.cloud import (
    POINT_CLOUD2,
    POINT_CLOUD2_DEFINITION,
    cloud_of,
    labels_of,
    message_of,
)
from workers.lab.simulation.sensor.lidar import sweep
from workers.lab.simulation.world.street_builder import build_street
from workers.parts.protocols import Parts
from workers.pipeline import mine_shard
from workers.version import parts_of

ANSWERED = {"planted": "recorded"}
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
    write_bare_log(folder)
    (folder / "truth" / KEY / "planted.json").unlink()
    return folder


@pytest.fixture(scope="module")
def parts(fleet: Path) -> Parts:
    return parts_of(settings_of(fleet))


@pytest.fixture(scope="module")
def drive(fleet: Path, parts: Parts) -> Drive:
    return drive_of(fleet, parts)


def test_a_variant_equals_a_log_that_contains_its_labels(
    fleet: Path, drive: Drive, parts: Parts, tmp_path: Path
) -> None:
    failures = place_failures(drive, TWO_FAILURES)
    assert len(failures) == 2
    labels = list(labels_of_variant(drive, TWO_FAILURES, failures))
    replayed = [
        bytes_of(mined, parts) for mined in mine_answers(drive, labels, parts, pipeline_version="0")
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
        writer.finish()  # type: ignore[no-untyped-call]  # upstream lacks the return type
    bucket = open_bucket(str(tmp_path))
    recording = jobs_of(str(tmp_path), fleet / "truth")[0].recording
    settings = settings_of(fleet)
    (shard,) = shards_of_log(bucket, recording, settings)
    assert shard.recorded is not None
    frames = read_shard(bucket, recording, shard, settings).frames()
    mined = mine_shard(shard, frames, parts_of(settings), pipeline_version="0")
    assert [bytes_of(each, parts) for each in mined] == replayed
    assert len(replayed) == 2


def test_failures_are_planted_in_the_scenes_that_the_plan_names(drive: Drive) -> None:
    (parked, missed) = place_failures(drive, TWO_FAILURES)
    assert (parked.kind, missed.kind) == (
        FailureKind.PARKED_CALLED_MOVING,
        FailureKind.MISSED_MOVER,
    )
    assert 0.7 <= parked.start_s < parked.end_s <= 2.0 <= missed.start_s < missed.end_s <= 4.0
    assert min(parked.end_s - parked.start_s, missed.end_s - missed.start_s) >= 0.6
    assert place_failures(drive, TWO_FAILURES) == [parked, missed]
    during = next(frame for frame in drive.frames if frame.time_s >= parked.start_s)
    labels = list(labels_of_variant(drive, TWO_FAILURES, [parked, missed]))[during.index]
    assert labels.motion is not None
    mine = during.track == parked.track
    assert (during.motion[mine] == 1).all()
    assert (labels.motion[mine] == 2).mean() > 0.5


def test_the_plan_has_the_exact_share_and_one_failure_to_a_variant_first() -> None:
    plan = plan_variants(Planting(variants=30, share=1 / 6, seed=2), {"a": 2, "b": 1})
    planned = [len(variant.planned) for variants in plan.values() for variant in variants]
    assert sum(planned) == round(90 / 6)
    assert max(planned) == 1
    many = plan_variants(Planting(variants=4, share=0.5), {"a": 6})["a"]
    assert [len(variant.planned) for variant in many] == [3, 3, 3, 3]
    assert all(len({scene for scene, _ in variant.planned}) == 3 for variant in many)
    seeds = {variant.seed for variants in plan.values() for variant in variants}
    assert len(seeds) == 60
    assert plan == plan_variants(Planting(variants=30, share=1 / 6, seed=2), {"b": 1, "a": 2})


def test_a_drive_of_some_frames_starts_with_the_first_of_them(fleet: Path, parts: Parts) -> None:
    bucket = open_bucket(str(fleet / "logs"))
    recording = jobs_of(str(fleet / "logs"), fleet / "truth")[0].recording
    truth = LogTruth.beside(recording, fleet / "truth")
    assert truth is not None
    settings, chosen = settings_of(fleet), FrameRange(5, 30)
    some = load_drive(bucket, recording, truth, settings, parts, frames=chosen)
    assert len(some.frames) == 25
    assert some.frames[0].time_s == 0.0
    assert some.shard.anchor_ns == some.frames[0].posed.frame.stamp_ns
    assert some.scenes == ((0, 25),)
    np.testing.assert_array_equal(some.frames[0].posed.odom_from_sensor, np.eye(4))


def bench(fleet: Path, planting: Planting, kept: Path | None) -> tuple[FailureBench, PlantedFile]:
    return bench_planting(
        str(fleet / "logs"),
        fleet / "truth",
        settings_of(fleet),
        planting,
        processes=1,
        kept=kept,
        draws=10,
    )


def test_variants_are_mined_ranked_listed_and_kept(fleet: Path, tmp_path: Path) -> None:
    planting = Planting(variants=4, share=0.25)
    made, planted = bench(fleet, planting, tmp_path)
    table = made.planted
    assert table is not None
    assert (made.variants, made.within, made.judged) == (4, "within one drive", ANSWERED)
    assert (table.scenes, table.planted) == (8, 2)
    assert table.ap_interval is not None
    assert table.rare_ap is not None
    assert table.ap is not None
    assert table.rare_ap <= table.ap
    assert len(list(tmp_path.iterdir())) == 4
    listed = [failure for variant in planted.variants for failure in variant.failures]
    assert len(listed) == 2
    assert all(failure.shown == (failure.wrong is not None) for failure in listed)
    again, planted_again = bench(fleet, planting, tmp_path)
    assert (again, planted_again) == (made, planted)


def test_truth_without_tracks_is_refused_in_one_sentence(fleet: Path, tmp_path: Path) -> None:
    folder = tmp_path / KEY
    folder.mkdir(parents=True)
    for file in sorted((fleet / "truth" / KEY).glob("*.npz")):
        with np.load(file) as arrays:
            if "motion" in arrays:
                np.savez_compressed(folder / file.name, motion=arrays["motion"])
    with pytest.raises(TruthUnusableError, match="no motion or no tracks; --plant needs both"):
        bench_planting(
            str(fleet / "logs"),
            tmp_path,
            settings_of(fleet),
            Planting(variants=1),
            processes=1,
            kept=None,
        )
