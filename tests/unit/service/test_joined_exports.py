"""Scenes of several lidars: exported points and finished labels return to topic and raw point."""

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from schemas.canonical import sha256
from schemas.overlay import Overlay
from schemas.score import SceneScore
from schemas.transport.bucket import open_bucket
from schemas.transport.overlay_codec import decode_overlay
from schemas.transport.wire import encode_scene_score
from service.curation.ranking import RankedScene
from service.curation.selection import Selection
from service.export.formats import FORMATS
from service.export.judging import judge
from service.export.label_import import read_scenes, write_truth
from service.export.labels.forms import form_named
from service.export.running import run_export
from service.export.scene import SceneToExport
from tests.factories import street_log
from tests.tiny_logs import only_recording, settings
from workers.excerpt.further_clouds import FramesMissingError
from workers.excerpt.source import BucketExcerpts
from workers.ingest.plan import plan_recording
from workers.ingest.pointcloud import decode_cloud
from workers.ingest.read import read_shard
from workers.lab.simulation.sensor.lidar import UNIFORM_64, Lidar
from workers.mine import MinedRecord, MiningReport, mine_records
from workers.parts.registry import build_parts

TOP, FRONT = "/lidar/top/points", "/lidar/front/points"
CAR = 10
LIDAR = Lidar(elevation_deg=UNIFORM_64[::2], columns=360)


class Mined:
    """A log of two lidars, mined as one, and its first scene."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "logs"
        street_log(self.folder / "sim-01/2026-03-02/street.mcap", frames=24, lidars=2, lidar=LIDAR)
        self.bucket = open_bucket(str(self.folder))
        self.settings = settings(supervised="recorded").model_copy(
            update={"lidar_topic": f"{TOP},{FRONT}"}
        )
        self.recording = only_recording(self.bucket)
        self.plan = plan_recording(self.bucket, self.recording, self.settings)
        self.first: MinedRecord = next(
            mine_records(
                *(self.bucket, self.recording, self.plan.shards[0]),
                settings=self.settings,
                parts=build_parts(
                    odometry="kiss-icp", supervised="recorded", selfsupervised="registration"
                ),
                pipeline_version="0123456789ab",
                report=MiningReport(),
            )
        )

    @property
    def score(self) -> SceneScore:
        return self.first.score

    @property
    def overlay(self) -> Overlay:
        return decode_overlay(self.first.overlay)

    def export(self, form: str, out: Path) -> Path:
        out.mkdir(parents=True)
        row = RankedScene(
            rank=1,
            scene_id=self.score.scene_id,
            log_id=self.score.log_id,
            start_ns=self.score.start_ns,
            end_ns=self.score.end_ns,
            score=self.score.score,
            reasons=(),
            sha256=sha256(encode_scene_score(self.score)),
        )

        def open_scene(number: int, row: RankedScene) -> SceneToExport:
            return SceneToExport(
                number=number,
                selection="week",
                row=row,
                score=self.score,
                sha256=row.sha256,
                verdicts=(),
                open_overlay=lambda: self.overlay,
                source=BucketExcerpts(open_bucket(str(self.folder))),
            )

        chosen = Selection(name="week", strategy="best-distinct", budget=1, scenes=(row,))
        report = run_export(chosen, FORMATS[form], out, open_scene)
        assert not report.missing, report
        return out


@pytest.fixture(scope="module")
def mined(tmp_path_factory: pytest.TempPathFactory) -> Mined:
    return Mined(tmp_path_factory.mktemp("joined"))


def test_the_overlay_says_which_points_are_of_which_lidar(mined: Mined) -> None:
    overlay = mined.overlay
    (front,) = overlay.lidars
    assert front.topic == FRONT
    frames = list(
        read_shard(mined.bucket, mined.recording, mined.plan.shards[0], mined.settings).frames()
    )
    by_stamp = {frame.stamp_ns: frame for frame in frames}
    for number, stamp_ns in enumerate(overlay.stamps_ns.tolist()):
        read = by_stamp[stamp_ns]
        assert overlay.main_points[number] == read.main_points
        assert front.points[number] == read.joined[0].points > 0
        assert front.stamps_ns[number] == read.joined[0].stamp_ns


def test_points_of_the_front_lidar_are_compared(mined: Mined) -> None:
    overlay = mined.overlay
    for number in range(8, len(overlay)):
        points = overlay.points_of(number)
        front = overlay.agreements[points][overlay.main_points[number] :]
        assert (front != overlay.task.not_compared).mean() > 0.5


def test_each_exported_point_leads_back_to_topic_and_raw_point(
    mined: Mined, tmp_path: Path
) -> None:
    out = mined.export("semantickitti", tmp_path / "out") / "sequences" / "00"
    listed = json.loads((out / "frames.json").read_text())["frames"]
    for frame in listed:
        (front,) = frame["lidars"]
        assert (frame["topic"], front["topic"]) == (TOP, FRONT)
        index = np.fromfile(out / "index" / f"{frame['index']:06d}.bin", "<u4").astype(int)
        points = np.fromfile(out / "velodyne" / f"{frame['index']:06d}.bin", "<f4").reshape(-1, 4)
        of_front = index >= front["first"]
        assert frame["raw_points"] == front["first"] + front["points"]
        assert of_front.sum() > 0
        # a raw point of the front lidar, moved by the transform of the overlay, is the exported one
        clouds = [each for each in _clouds(mined, FRONT) if each.stamp_ns == front["header_stamp"]]
        (cloud,) = clouds
        own = np.column_stack([cloud.fields[axis] for axis in "xyz"])
        number = frame["index"]
        moved = mined.overlay.lidars[0].main_from_lidar[number]
        expected = own[index[of_front] - front["first"]] @ moved[:3, :3].T + moved[:3, 3]
        np.testing.assert_allclose(points[of_front, :3], expected, atol=1e-4)


def _clouds(mined: Mined, topic: str):  # type: ignore[no-untyped-def]
    from workers.ingest.messages import RawMessage

    channel = next(
        each.channel for each in mined.plan.shards[0].further if each.channel.topic == topic
    )
    with next(mined.folder.rglob("*.mcap")).open("rb") as file:
        for _, _, message in make_reader(file).iter_messages([topic]):
            yield decode_cloud(RawMessage(channel, message.log_time, message.data))


def test_finished_labels_become_truth_of_each_lidar(mined: Mined, tmp_path: Path) -> None:
    out = mined.export("semantickitti", tmp_path / "out")
    for path in (out / "sequences" / "00" / "labels").iterdir():
        words = np.fromfile(path, "<u4")
        np.full(len(words), CAR, "<u4").tofile(path)
    (scene,) = read_scenes(
        out, form_named("semantickitti"), lambda scene_id: (mined.score, mined.overlay)
    )
    overlay = mined.overlay
    tops = [each for each in scene.frames if each.topic == TOP]
    fronts = [each for each in scene.frames if each.topic == FRONT]
    assert len(tops) == len(fronts) == len(overlay)
    for top, front in zip(tops, fronts, strict=True):
        assert len(top.words) == overlay.main_points[top.number]
        assert len(front.words) == overlay.lidars[0].points[front.number]
        assert front.stamp_ns == overlay.lidars[0].stamps_ns[front.number]
    judged = judge(overlay, scene.frames)
    assert (
        sum(each.points for each in judged)
        == (overlay.instance_track[overlay.instance_index[overlay.instance_index >= 0]] >= -1).sum()
    )
    write_truth([scene], tmp_path / "truth")
    listing = json.loads((tmp_path / "truth" / scene.log_id / "frames.json").read_text())
    assert [each["topic"] for each in listing["frames"]] == [TOP] * len(tops) + [FRONT] * len(tops)


def test_the_excerpt_has_the_raw_messages_of_both_lidars(mined: Mined, tmp_path: Path) -> None:
    out = mined.export("mcap", tmp_path / "out")
    (path,) = out.glob("*.mcap")
    with path.open("rb") as file, next(mined.folder.rglob("*.mcap")).open("rb") as log:
        reader = make_reader(file)
        copied = {
            (channel.topic, message.log_time): message.data
            for _, channel, message in reader.iter_messages([TOP, FRONT])
        }
        (about,) = [json.loads(each.data) for each in reader.iter_attachments()]
        recorded = {
            (channel.topic, message.log_time): message.data
            for _, channel, message in make_reader(log).iter_messages([TOP, FRONT])
        }
    assert {topic for topic, _ in copied} == {TOP, FRONT}
    assert all(recorded[key] == data for key, data in copied.items())
    assert about["lidars"][0]["topic"] == FRONT
    assert len(about["lidars"][0]["points"]) == len(mined.overlay)


def test_a_cloud_that_the_log_lost_is_named(mined: Mined, tmp_path: Path) -> None:
    street_log(tmp_path / "logs/sim-01/2026-03-02/street.mcap", frames=24, lidars=1)
    source = BucketExcerpts(open_bucket(str(tmp_path / "logs")))
    with pytest.raises(FramesMissingError, match="has no cloud of /lidar/front/points"):
        list(source.cut(mined.score, mined.overlay).clouds())


def test_cuboids_label_the_points_of_each_lidar(mined: Mined, tmp_path: Path) -> None:
    out = mined.export("openlabel", tmp_path / "out")
    overlay = mined.overlay
    (scene,) = read_scenes(out, form_named("openlabel"), lambda scene_id: (mined.score, overlay))
    tops = [each for each in scene.frames if each.topic == TOP]
    fronts = [each for each in scene.frames if each.topic == FRONT]
    assert [len(each.words) for each in tops] == overlay.main_points.tolist()
    assert [len(each.words) for each in fronts] == overlay.lidars[0].points.tolist()
    assert [each.stamp_ns for each in fronts] == overlay.lidars[0].stamps_ns.tolist()
    assert all(each.is_unchanged for each in scene.frames)
    for top, front in zip(tops, fronts, strict=True):
        labelled = np.concatenate([top.motion, front.motion]) > 0
        instance = overlay.instance_index[overlay.points_of(top.number)]
        assert labelled[instance >= 0].all()
