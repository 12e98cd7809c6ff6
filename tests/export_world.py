"""A small log, the overlay and record of one of its scenes, and exports of a selection of it."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from mcap_ros2._dynamic import serialize_dynamic

from schemas.attribution import Attribution, Wrong
from schemas.canonical import sha256
from schemas.labels import Agreement
from schemas.overlay import NO_POSITION_CM, Overlay, labels_from_agreements
from schemas.score import Reason, SceneScore
from schemas.task import MOTION
from schemas.transport.bucket import open_bucket
from schemas.transport.wire import encode_scene_score
from service.curation.ranking import RankedScene
from service.curation.selection import Selection
from service.errors import NothingFoundError
from service.export.formats import FORMATS
from service.export.running import ExportReport, run_export
from service.export.scene import JudgedTrack, SceneToExport
from tests.factories import scene_score, track_record
from tests.tiny_logs import BEGIN_NS, LIDAR, cloud
from workers.excerpt.source import BucketExcerpts
from workers.ingest.ros_definitions import ROS2_DEFINITIONS

LOG_ID = "car-7/2026-11-20/drive"
STEP_NS = 100_000_000
FRAMES = 4
POINTS = 40
SILENT = 7
"""Every seventh point has no return."""
MOVER = range(10, 18)
"""Points that only the self-supervised stream labels moving; the attribution finds it right."""
WALKER = range(20, 26)
"""Points that both streams label moving."""
CLASSES = ("unlabeled", "car", "pedestrian", "building")


def rows(number: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return x, y, z and intensity of the frame of this number; rows without a return are NaN."""
    made = np.zeros((POINTS, 4), dtype="<f4")
    angle = np.linspace(-np.pi, np.pi, POINTS, endpoint=False)
    made[:, 0], made[:, 1] = 10 * np.cos(angle) + 0.1 * number, 10 * np.sin(angle)
    made[:, 2] = np.linspace(-2, 1, POINTS)
    made[:, 3] = np.linspace(0, 1, POINTS)
    made[::SILENT, :3] = np.nan
    return made


def returns() -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return the raw indices of the points with a return."""
    return np.flatnonzero(np.arange(POINTS) % SILENT != 0)


def write_log(folder: Path, *, frames: int = 40, first: int = 0, part: str = "") -> Path:
    """Write the log: a lidar of ten hertz, static transforms at its begin, and another lidar.

    Args:
        folder: Of the bucket.
        frames: Number after the last frame.
        first: The first frame; the transforms are written with frame 0.
        part: `_0` and so on, for a part of a split recording.
    """
    path = folder / f"{LOG_ID}{part}.mcap"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4000)
        writer.start(profile="ros2", library="test")
        writer.add_metadata("licence", {"name": "CC BY 4.0"})
        ids = {}
        for topic, kind in (
            (LIDAR, "sensor_msgs/PointCloud2"),
            ("/other/points", "sensor_msgs/PointCloud2"),
            ("/tf_static", "tf2_msgs/TFMessage"),
        ):
            schema = writer.register_schema(
                kind.replace("/", "/msg/"), "ros2msg", ROS2_DEFINITIONS[kind].encode()
            )
            ids[topic] = writer.register_channel(topic, "cdr", schema, {"qos": "latched"})
        if not first:
            writer.add_message(ids["/tf_static"], BEGIN_NS, static_transform(), BEGIN_NS)
        for number in range(first, frames):
            at_ns = BEGIN_NS + number * STEP_NS
            data = cloud(at_ns, rows(number).tobytes(), ("x", "y", "z", "intensity"))
            for topic in (LIDAR, "/other/points"):
                writer.add_message(ids[topic], at_ns + 5_000_000, data, at_ns + 3_000_000)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def static_transform() -> bytes:
    kind = "tf2_msgs/TFMessage"
    encode = serialize_dynamic("tf2_msgs/msg/TFMessage", ROS2_DEFINITIONS[kind])
    placed = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "base_link"},
        "child_frame_id": "lidar",
        "transform": {
            "translation": {"x": 1.0, "y": 0.0, "z": 1.8},
            "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        },
    }
    return bytes(encode["tf2_msgs/msg/TFMessage"]({"transforms": [placed]}))


def record(number: int = 0) -> SceneScore:
    """Return the record of a scene that begins at the twentieth frame, or later."""
    start_ns = BEGIN_NS + (20 + FRAMES * number) * STEP_NS
    attribution = Attribution(
        wrong=Wrong.SUPERVISED, supervised=0.9, selfsupervised=0.1, both=0.0, neither=0.0
    )
    return scene_score(
        log_id=LOG_ID,
        scene_id=f"{LOG_ID}/lidar.points/{start_ns}",
        lidar_topic=LIDAR,
        start_ns=start_ns,
        end_ns=start_ns + (FRAMES - 1) * STEP_NS,
        frames=FRAMES,
        points=FRAMES * POINTS,
        tracks=(
            track_record(
                kind="only_predictive_dynamic",
                class_name="car",
                strength=0.75,
                first_ns=start_ns,
                last_ns=start_ns + (FRAMES - 1) * STEP_NS,
                attribution=attribution,
            ),
        ),
        reasons=(Reason(headline="supervised labels car static, but it moves", track_id=0),),
    )


def overlay(score: SceneScore) -> Overlay:
    """Return the overlay of a scene: a mover, a walker, and buildings."""
    agreements = np.full((FRAMES, POINTS), Agreement.BOTH_STATIC, dtype=np.uint8)
    agreements[:, MOVER] = Agreement.ONLY_PREDICTIVE_DYNAMIC
    agreements[:, WALKER] = Agreement.BOTH_DYNAMIC
    agreements[:, ::SILENT] = Agreement.NOT_COMPARED
    class_id = np.full((FRAMES, POINTS), 3, dtype=np.int16)
    class_id[:, MOVER], class_id[:, WALKER] = 1, 2
    class_id[:, ::SILENT] = -1
    instance = np.full((FRAMES, POINTS), -1, dtype=np.int32)
    for number in range(FRAMES):
        instance[number, MOVER] = number
    semantic, predictive = labels_from_agreements(agreements.reshape(-1))
    first = (score.start_ns - BEGIN_NS) // STEP_NS
    placed = np.stack([rows(first + number)[:, :3] for number in range(FRAMES)])
    points_cm = np.where(np.isnan(placed), NO_POSITION_CM, np.nan_to_num(placed) * 100)
    poses = np.repeat(np.eye(4)[None], FRAMES, axis=0)
    poses[:, 0, 3] = 0.5 * np.arange(FRAMES)
    boxes = np.tile(np.array([9, -4, 0, 4, 2, 1.5, 0.3], dtype=np.float32), (FRAMES, 1))
    return Overlay(
        scene_id=score.scene_id,
        stamps_ns=score.start_ns + STEP_NS * np.arange(FRAMES, dtype=np.int64),
        offsets=POINTS * np.arange(FRAMES + 1, dtype=np.int64),
        points_cm=np.round(points_cm).astype(np.int16).reshape(-1, 3),
        semantic_labels=semantic,
        predictive_labels=predictive,
        witness_labels=np.full(FRAMES * POINTS, MOTION.unknown, dtype=np.uint8),
        ground_mask=np.zeros(FRAMES * POINTS, dtype=np.bool_),
        class_id=class_id.reshape(-1),
        class_names=CLASSES,
        semantic_confidence=np.full(FRAMES * POINTS, 255, dtype=np.uint8),
        predictive_confidence=np.full(FRAMES * POINTS, 255, dtype=np.uint8),
        instance_index=instance.reshape(-1),
        odom_from_sensor=poses,
        instance_frame=np.arange(FRAMES, dtype=np.int32),
        instance_kind=np.full(FRAMES, Agreement.ONLY_PREDICTIVE_DYNAMIC, dtype=np.uint8),
        instance_track=np.zeros(FRAMES, dtype=np.int32),
        instance_boxes=boxes,
    )


@dataclass
class ExportWorld:
    """A bucket with the log, and a state with the scenes of a selection.

    Attributes:
        bucket: Folder of the logs.
        records: Record of each scene, by id; a scene that is removed is no longer current.
        verdicts: Verdicts on every scene.
    """

    bucket: Path
    records: dict[str, SceneScore] = field(default_factory=dict)
    verdicts: tuple[JudgedTrack, ...] = ()

    def selection(self, name: str = "week", *, scenes: int = 2) -> Selection:
        """Choose the first scenes, and remember their records."""
        chosen = [record(number) for number in range(scenes)]
        self.records.update({each.scene_id: each for each in chosen})
        ranked = [self._row(rank, each) for rank, each in enumerate(chosen, start=1)]
        return Selection(name=name, strategy="best-distinct", budget=scenes, scenes=tuple(ranked))

    def export(self, selection: Selection, form: str, out: Path) -> ExportReport:
        """Run an export into a folder, which is made."""
        out.mkdir(parents=True, exist_ok=True)
        return run_export(selection, FORMATS[form], out, self.opener(selection))

    def opener(self, selection: Selection) -> Any:
        logs = BucketExcerpts(open_bucket(str(self.bucket)))

        def open_scene(number: int, row: RankedScene) -> SceneToExport:
            score = self.records.get(row.scene_id)
            if score is None:
                raise NothingFoundError(f"no current scene {row.scene_id!r}")
            return SceneToExport(
                number=number,
                selection=selection.name,
                row=row,
                score=score,
                sha256=sha256(encode_scene_score(score)),
                verdicts=self.verdicts,
                open_overlay=lambda: overlay(score),
                source=logs,
            )

        return open_scene

    def _row(self, rank: int, score: SceneScore) -> RankedScene:
        return RankedScene(
            rank=rank,
            scene_id=score.scene_id,
            log_id=score.log_id,
            start_ns=score.start_ns,
            end_ns=score.end_ns,
            score=score.score,
            reasons=tuple(each.headline for each in score.reasons),
            sha256=sha256(encode_scene_score(score)),
        )


def made_world(folder: Path) -> ExportWorld:
    """Write the log into a folder, and return the world around it."""
    write_log(folder / "logs")
    return ExportWorld(folder / "logs")


def files_of(out: Path) -> Iterable[str]:
    """Return the relative paths of all files of an output, sorted."""
    return sorted(p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file())
