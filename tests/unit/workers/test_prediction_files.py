"""A model's answer in files next to the logs: labels per cloud, and Parquet of boxes."""

import json
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from schemas.frame import LidarFrame
from schemas.transport.bucket import open_bucket
from tests.box_logs import clouds, read, stamp, transform, write
from tests.factories import posed
from tests.tiny_logs import only_recording, settings
from workers.errors import LogUnusableError
from workers.ingest.footer import PredictionsAwaitedError
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.supervised.box_labels import NO_MOTION
from workers.supervised.recorded import Recorded

POINTS = 864
CAR, MOVING_CAR, ROAD = 10, 252, 40


def label_files(folder: Path, ids: list[int], *, count: int = 20, by_stamp: bool = False) -> None:
    folder.mkdir(parents=True)
    for number in range(count):
        labels = np.resize(np.array(ids, "<u4"), POINTS) | np.uint32(7 << 16)  # with an instance
        name = f"{stamp(number)}" if by_stamp else f"{number:06d}"
        (folder / f"{name}.label").write_bytes(labels.astype("<u4").tobytes())


@pytest.mark.parametrize("by_stamp", [False, True])
@pytest.mark.parametrize("folder", ["drive", "fleet/drive"])
def test_labels_come_by_number_or_stamp_and_by_either_name_of_the_log(
    tmp_path: Path, folder: str, by_stamp: bool
) -> None:
    label_files(tmp_path / folder, [CAR, ROAD, MOVING_CAR, 0], by_stamp=by_stamp)
    frames, said = read(write(clouds()), predictions=str(tmp_path))
    assert said == []
    assert len(frames) == 20
    stream = Recorded()
    for found in stream([posed(frame) for frame in frames]):
        assert found.labels[:4].tolist() == [0, 0, 1, 2]
        assert found.health.reason == ""
    assert "moving-car" in stream.class_names


def test_later_shards_count_the_clouds_before_them(tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    folder.mkdir()
    for number in range(60):
        labels = np.full(POINTS, CAR if number < 45 else ROAD, "<u4")
        (folder / f"{number:06d}.label").write_bytes(labels.tobytes())
    bucket = open_bucket("memory://")
    bucket.put("fleet/drive.mcap", write(clouds(60)))
    using = settings(supervised="recorded", shard_s=2.0).model_copy(
        update={"predictions": str(tmp_path)}
    )
    recording = only_recording(bucket)
    plan = plan_recording(bucket, recording, using)
    assert len(plan.shards) == 3
    for shard in plan.shards:
        reader = read_shard(bucket, recording, shard, using)
        for frame in reader.frames():
            assert frame.recorded is not None
            number = round((frame.stamp_ns - stamp(0)) / 1e8)
            assert frame.recorded.class_id[0] == (CAR if number < 45 else ROAD)


def test_a_network_that_names_but_says_no_motion_is_judged_for_what_it_can(tmp_path: Path) -> None:
    label_files(tmp_path / "drive", [CAR, ROAD])
    frames, _ = read(write(clouds()), predictions=str(tmp_path))
    (found,) = Recorded()([posed(frames[0])])
    assert found.labels[:2].tolist() == [2, 0]
    assert found.health.reason == NO_MOTION


def test_classes_next_to_the_files_win(tmp_path: Path) -> None:
    label_files(tmp_path / "drive", [3])
    classes = {"3": {"name": "tram", "movable": True, "moving": True}}
    (tmp_path / "classes.json").write_text(json.dumps(classes))
    frames, _ = read(write(clouds()), predictions=str(tmp_path))
    (found,) = Recorded()([posed(frames[0])])
    assert found.labels[0] == 1


def test_a_file_of_another_length_costs_its_frame(tmp_path: Path) -> None:
    label_files(tmp_path / "drive", [ROAD], count=18)
    (tmp_path / "drive" / "000003.label").write_bytes(b"\0" * 400)
    frames, said = read(write(clouds()), predictions=str(tmp_path))
    unanswered = [number for number, frame in enumerate(frames) if frame.recorded is None]
    assert unanswered == [3, 18, 19]
    assert any("000003.label has 400 bytes, 864 points need 3456" in each for each in said)
    assert any("2 clouds have no file of labels" in each for each in said)


def test_no_files_are_a_refusal_that_names_what_is_wanted(tmp_path: Path) -> None:
    bucket = open_bucket("memory://")
    bucket.put("fleet/drive.mcap", write(clouds()))
    using = settings(supervised="recorded").model_copy(update={"predictions": str(tmp_path)})
    plan = plan_recording(bucket, only_recording(bucket), using)
    assert "drive/000000.label" in plan.refused
    assert "drive.parquet" in plan.refused
    with pytest.raises(PredictionsAwaitedError, match="no predictions for fleet/drive"):
        plan_recording(bucket, only_recording(bucket), using, waits=True)
    label_files(tmp_path / "drive", [10])
    assert plan_recording(bucket, only_recording(bucket), using, waits=True).shards


def parquet_of_boxes(path: Path, *, frame_id: str = "", without: str = "") -> None:
    rows = [
        {
            "stamp_ns": stamp(number),
            "frame_id": frame_id,
            "x": 5.0 + number,
            "y": 1.0,
            "z": 0.0,
            "length": 4.0,
            "width": 2.0,
            "height": 1.5,
            "yaw": 0.5,
            "vx": 3.0,
            "vy": 0.0,
            "class_name": "car",
            "score": 0.5,
            "track_id": 17,
        }
        for number in reversed(range(20))
    ]
    kept = [{name: value for name, value in row.items() if name != without} for row in rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    out = BytesIO()
    parquet.write_table(pa.Table.from_pylist(kept), out)
    path.write_bytes(out.getvalue())


def replace_column(file: Path, name: str, values: pa.Array | pa.ChunkedArray) -> None:
    table = parquet.read_table(file)
    parquet.write_table(table.set_column(table.column_names.index(name), name, values), file)


def boxed(frames: list[LidarFrame]) -> list[float]:
    return [float(frame.boxes.centre_m[0, 0]) for frame in frames if frame.boxes is not None]


@pytest.mark.parametrize("name", ["drive.parquet", "drive/boxes.parquet", "fleet/drive.parquet"])
def test_boxes_come_from_parquet(tmp_path: Path, name: str) -> None:
    parquet_of_boxes(tmp_path / name)
    frames, said = read(write(clouds()), predictions=str(tmp_path))
    assert said == []
    assert boxed(frames) == [5.0 + number for number in range(20)]
    assert frames[0].boxes is not None
    assert frames[0].boxes.track_id == ("17",)
    np.testing.assert_allclose(frames[0].boxes.velocity_m_per_s, [(3.0, 0.0, 0.0)])


@pytest.mark.parametrize("nothing", [None, float("nan")], ids=["null", "NaN"])
def test_a_row_of_the_stamp_alone_says_that_nothing_was_found(
    tmp_path: Path, nothing: float | None
) -> None:
    file = tmp_path / "drive.parquet"
    parquet_of_boxes(file)
    rows = parquet.read_table(file).to_pylist()
    rows[0] = {name: rows[0]["stamp_ns"] if name == "stamp_ns" else nothing for name in rows[0]}
    rows[0]["frame_id"] = rows[0]["class_name"] = None
    parquet.write_table(pa.Table.from_pylist(rows), file)
    frames, said = read(write(clouds()), predictions=str(tmp_path))
    assert said == []
    assert [len(frame.boxes) for frame in frames if frame.boxes is not None] == [1] * 19 + [0]


def test_boxes_in_parquet_are_placed_by_the_transforms_of_the_log(tmp_path: Path) -> None:
    parquet_of_boxes(tmp_path / "drive.parquet", frame_id="base")
    log = write([*clouds(), transform("base", "lidar", 2.0, log_time_ns=stamp(0))])
    frames, said = read(log, predictions=str(tmp_path))
    assert said == []
    assert boxed(frames) == [3.0 + number for number in range(20)]


def test_parquet_without_a_column_ends_in_a_sentence(tmp_path: Path) -> None:
    parquet_of_boxes(tmp_path / "drive.parquet", without="width")
    with pytest.raises(LogUnusableError, match="lacks the columns width"):
        read(write(clouds()), predictions=str(tmp_path))


def test_stamps_that_are_no_whole_numbers_end_in_a_sentence(tmp_path: Path) -> None:
    file = tmp_path / "drive.parquet"
    parquet_of_boxes(file)
    table = parquet.read_table(file)
    for kind in (pa.float64(), pa.timestamp("ns")):
        replace_column(file, "stamp_ns", table["stamp_ns"].cast(kind, safe=False))
        with pytest.raises(LogUnusableError, match=r"stamp_ns is of the type .* as int64"):
            read(write(clouds()), predictions=str(tmp_path))


@pytest.mark.parametrize(
    ("unit", "factor"), [("microseconds", 1_000), ("milliseconds", 10**6), ("seconds", 10**9)]
)
def test_stamps_in_another_unit_are_named_with_it(tmp_path: Path, unit: str, factor: int) -> None:
    file = tmp_path / "drive.parquet"
    parquet_of_boxes(file)
    stamps = parquet.read_table(file)["stamp_ns"].to_pylist()
    replace_column(file, "stamp_ns", pa.array([value // factor for value in stamps]))
    with pytest.raises(LogUnusableError, match=f"stamp_ns has {unit}: .* multiply by {factor:,}"):
        read(write(clouds()), predictions=str(tmp_path))


def test_half_of_a_velocity_is_refused(tmp_path: Path) -> None:
    parquet_of_boxes(tmp_path / "drive.parquet", without="vy")
    with pytest.raises(LogUnusableError, match="only vx of the columns vx, vy"):
        read(write(clouds()), predictions=str(tmp_path))


def test_a_yaw_in_degrees_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "drive.parquet"
    parquet_of_boxes(file)
    replace_column(file, "yaw", pa.array([178.5] * 20))
    with pytest.raises(LogUnusableError, match=r"has the yaw 178.5: it needs radians"):
        read(write(clouds()), predictions=str(tmp_path))


def test_boxes_that_share_an_identity_have_none_and_it_is_said(tmp_path: Path) -> None:
    file = tmp_path / "drive.parquet"
    parquet_of_boxes(file)
    table = parquet.read_table(file)
    parquet.write_table(pa.concat_tables([table, table]), file)
    frames, said = read(write(clouds()), predictions=str(tmp_path))
    assert frames[0].boxes is not None
    assert frames[0].boxes.track_id == ("", "")
    assert len(said) == 1
    assert "20 answers give one identity to several boxes, the first '17'" in said[0]


def test_answers_of_another_time_are_counted_with_their_own(tmp_path: Path) -> None:
    file = tmp_path / "drive.parquet"
    parquet_of_boxes(file)
    stamps = parquet.read_table(file)["stamp_ns"].to_pylist()
    for seconds in (20, -20):
        moved = [value + seconds * 10**9 for value in stamps]
        replace_column(file, "stamp_ns", pa.array(moved))
        _, said = read(write(clouds()), predictions=str(tmp_path))
        assert len(said) == 2
        assert said[0].startswith("20 clouds have no answer")
        assert said[1].startswith(
            f"20 answers match no cloud, the first at {min(moved) / 1e9:.3f} s"
        )


def test_an_answer_in_two_frames_is_refused_not_halved(tmp_path: Path) -> None:
    file = tmp_path / "drive.parquet"
    parquet_of_boxes(file, frame_id="base")
    table = parquet.read_table(file)
    other = table.drop_columns("frame_id").append_column(
        "frame_id", pa.array([""] * table.num_rows)
    )
    parquet.write_table(pa.concat_tables([table, other.select(table.column_names)]), file)
    with pytest.raises(LogUnusableError, match=r"boxes in several frames, the first \(''"):
        read(write(clouds()), predictions=str(tmp_path))


def test_without_pyarrow_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parquet_of_boxes(tmp_path / "drive.parquet")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(LogUnusableError, match=r"counterpoint\[predictions\]"):
        read(write(clouds()), predictions=str(tmp_path))
