"""Import of finished labels: by index to raw points, as truth that the benches read."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from schemas.overlay import Overlay
from schemas.score import SceneScore
from schemas.transport.bucket import open_bucket
from service.errors import NothingFoundError, UsageError
from service.export.judging import OtherPointsError, judge
from service.export.label_import import ImportedScene, read_scenes, write_truth
from service.export.labels.forms import form_named
from tests.export_world import (
    FRAMES,
    LOG_ID,
    MOVER,
    POINTS,
    WALKER,
    ExportWorld,
    made_world,
    overlay,
    record,
    returns,
)
from tests.tiny_logs import BEGIN_NS, LIDAR, only_recording, settings
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.lab.evaluation.truth.truth import LogTruth

MOVING_CAR, CAR = 252, 10


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[ExportWorld, Path]:
    folder = tmp_path_factory.mktemp("import")
    world = made_world(folder)
    for form in ("semantickitti", "segments"):
        world.export(world.selection(), form, folder / form)
    return world, folder


@pytest.fixture
def sequences(exported: tuple[ExportWorld, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(exported[1] / "semantickitti", tmp_path / "finished"))


def scenes_in(folder: Path, form: str = "semantickitti") -> list[ImportedScene]:
    return list(read_scenes(folder, form_named(form), current))


def current(scene_id: str) -> tuple[SceneScore, Overlay]:
    raise NothingFoundError(f"no current scene {scene_id!r}")


@pytest.mark.parametrize("form", ["semantickitti", "segments"])
def test_each_label_returns_to_its_raw_point(exported: tuple[ExportWorld, Path], form: str) -> None:
    scenes = scenes_in(exported[1] / form, form)
    assert [len(scene.frames) for scene in scenes] == [FRAMES, FRAMES]
    assert all(frame.is_unchanged for scene in scenes for frame in scene.frames)
    for frame in scenes[0].frames:
        moving = np.isin(np.arange(POINTS), [*MOVER, *WALKER])
        silent = ~np.isin(np.arange(POINTS), returns())
        expected = np.where(moving, 2, 1)
        np.testing.assert_array_equal(frame.motion, np.where(silent, 0, expected))
        assert set(frame.semantic19[MOVER][frame.motion[MOVER] > 0]) == {1}


def test_random_labels_come_back_to_every_point_with_a_return(sequences: Path) -> None:
    words = np.arange(1, len(returns()) + 1, dtype="<u4") << 16 | MOVING_CAR
    words.tofile(sequences / "sequences/01/labels/000003.label")
    frame = scenes_in(sequences)[1].frames[3]
    np.testing.assert_array_equal(frame.words[returns()], words)
    np.testing.assert_array_equal(frame.track[returns()], np.arange(1, len(returns()) + 1))
    assert not np.delete(frame.words, returns()).any()
    assert [each.is_unchanged for each in scenes_in(sequences)[1].frames] == [True] * 3 + [False]


def test_a_label_too_many_is_refused(sequences: Path) -> None:
    path = sequences / "sequences/00/labels/000001.label"
    path.write_bytes(path.read_bytes() + bytes(4))
    with pytest.raises(UsageError, match="frame 1 has 35 labels for 34 points"):
        scenes_in(sequences)


def test_half_a_label_is_refused(sequences: Path) -> None:
    path = sequences / "sequences/00/labels/000001.label"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(UsageError, match="135 bytes are no whole labels"):
        scenes_in(sequences)


def test_an_index_beyond_the_message_is_refused(sequences: Path) -> None:
    index = returns().astype("<u4")
    index[-1] = POINTS
    index.tofile(sequences / "sequences/00/index/000001.bin")
    with pytest.raises(UsageError, match="frame 1 has a damaged index"):
        scenes_in(sequences)


def test_a_frame_without_labels_is_left_out(sequences: Path) -> None:
    (sequences / "sequences/00/labels/000001.label").unlink()
    scene = scenes_in(sequences)[0]
    assert ([each.number for each in scene.frames], scene.unlabelled) == ([0, 2, 3], 1)


def test_a_folder_of_something_else_is_refused(tmp_path: Path, sequences: Path) -> None:
    with pytest.raises(UsageError, match="this is no folder of an export"):
        scenes_in(tmp_path)
    with pytest.raises(UsageError, match=r"no such folder: .*/away"):
        scenes_in(tmp_path / "away")
    with pytest.raises(UsageError, match="an export as semantickitti, not as segments"):
        scenes_in(sequences, "segments")
    with pytest.raises(UsageError, match="no labels of format 'mcap' are read"):
        form_named("mcap")


def changed(sequences: Path, **changes: object) -> None:
    path = sequences / "sequences/00/frames.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


@pytest.mark.parametrize("log_id", ["../../etc/cron.d", "/etc/cron.d", ""])
def test_a_log_outside_the_folder_of_truth_is_refused(sequences: Path, log_id: str) -> None:
    changed(sequences, log_id=log_id)
    with pytest.raises(UsageError, match="log_id leads out of its folder"):
        scenes_in(sequences)


def test_a_frame_of_absurd_size_is_refused(sequences: Path) -> None:
    frame = {"index": 0, "topic": "/t", "header_stamp": 1, "points": 34, "raw_points": 2**40}
    changed(sequences, frames=[frame])
    with pytest.raises(UsageError, match="cannot read the frames of an exported scene"):
        scenes_in(sequences)


def test_a_broken_label_of_segments_is_refused(
    exported: tuple[ExportWorld, Path], tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(exported[1] / "segments", tmp_path / "finished"))
    (path,) = [each for each in folder.rglob("label.json") if "0000-" in str(each)]
    label = json.loads(path.read_text())
    del label["frames"][2]["annotations"]
    path.write_text(json.dumps(label))
    with pytest.raises(UsageError, match=r"this is no label of Segments\.ai: frame 2"):
        scenes_in(folder, "segments")


def test_the_benches_read_the_truth_and_skip_what_it_does_not_list(
    exported: tuple[ExportWorld, Path], sequences: Path, tmp_path: Path
) -> None:
    write_truth(scenes_in(sequences), tmp_path / "truth")
    bucket = open_bucket(str(exported[0].bucket))
    recording = only_recording(bucket)
    truth = LogTruth.beside(recording, tmp_path / "truth")
    assert truth is not None
    assert len(truth) == 2 * FRAMES
    of_lidar = settings().model_copy(update={"lidar_topic": LIDAR})
    (shard, *_) = plan_recording(bucket, recording, of_lidar).shards
    judged = 0
    for position, frame in enumerate(read_shard(bucket, recording, shard, of_lidar).frames()):
        found = truth.of(frame, number=truth.number_of(frame, position=position))
        assert (found is not None) == (20 <= (frame.stamp_ns - BEGIN_NS) // 10**8 < 28)
        if found is not None:
            judged += 1
            assert set(found.motion[[*MOVER]].tolist()) == {0, 2}
    assert judged == 2 * FRAMES


def test_a_contradiction_is_judged_by_the_labels_of_its_points(sequences: Path) -> None:
    scene = scenes_in(sequences)[0]
    (found,) = judge(overlay(record()), scene.frames)
    assert (found.track_id, found.verdict, found.points) == (0, "supervised", FRAMES * len(MOVER))
    assert found.judged_share == pytest.approx(7 / 8)
    for number in range(FRAMES):
        path = sequences / f"sequences/00/labels/{number:06d}.label"
        words = np.fromfile(path, dtype="<u4")
        np.where(words & 0xFFFF == MOVING_CAR, CAR, words).astype("<u4").tofile(path)
    (found,) = judge(overlay(record()), scenes_in(sequences)[0].frames)
    assert found.verdict == "self_supervised"


def test_labels_of_a_replaced_log_are_not_judged(sequences: Path) -> None:
    scene = scenes_in(sequences)[0]
    other = scene.frames[0]
    cut = type(other)(
        other.number, other.stamp_ns, other.topic, other.words[:-1], other.motion[:-1]
    )
    with pytest.raises(OtherPointsError, match="39 points in the export and 40 in the overlay"):
        judge(overlay(record()), [cut])


def test_truth_is_in_the_folder_of_the_log(sequences: Path, tmp_path: Path) -> None:
    assert write_truth(scenes_in(sequences), tmp_path / "truth") == 2 * FRAMES
    listed = json.loads((tmp_path / "truth" / LOG_ID / "frames.json").read_text())
    assert listed["partial"] is True
    assert [row["header_stamp"] for row in listed["frames"]] == sorted(
        row["header_stamp"] for row in listed["frames"]
    )
