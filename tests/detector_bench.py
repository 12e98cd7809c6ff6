"""A real log with a detector's output of each message type, mined end to end; planted errors found.

python -m tests.detector_bench --log LOG.mcap --truth FOLDER --out DIR [--kinds json,tracked]
"""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from numpy.typing import NDArray

from schemas.mining import Grid, MiningSettings
from schemas.score import SceneScore
from schemas.transport.bucket import open_object
from schemas.transport.recordings import recording_of
from tests.box_messages import (
    Box,
    Written,
    autoware,
    detections,
    header,
    published,
    ros1_detections,
    ros2,
    scene_json,
    scene_protobuf,
    xyz,
)
from tests.detector_output import (
    Planted,
    Truth,
    at_instant,
    detector_boxes,
    in_cloud,
    in_space,
    plant,
    read_truth,
)
from workers.ingest.ros_definitions import ROS2_DEFINITIONS
from workers.points.se3 import inverse
from workers.score import score_recording

TOPIC: Final = "/objects"
LATENCY_NS: Final = 80_000_000
NEAR_M: Final = 2.0
WEAK: Final = 0.05
"""Strength below which a record gives a track no reason."""


@dataclass(frozen=True)
class Kind:
    """A form in which a detector's output is recorded.

    Attributes:
        write: Message of boxes.
        space: `lidar_top`, `base_link`, or `map`, which needs /tf.
        velocity: Whether the message states one.
        ids: Whether boxes have identities.
        later_ns: Stamp of boxes after the cloud's; 0: found in the cloud itself.
    """

    write: Callable[..., Written]
    space: str = "lidar_top"
    velocity: bool = True
    ids: bool = True
    later_ns: int = 0


KINDS: Final = {
    "detection3d": Kind(detections, velocity=False),
    "detection3d-no-ids": Kind(detections, velocity=False, ids=False),
    "detection3d-ros1": Kind(ros1_detections, velocity=False, ids=False),
    "scene-protobuf": Kind(scene_protobuf, space="base_link"),
    "scene-json": Kind(scene_json),
    "tracked": Kind(partial(autoware, name="TrackedObjects"), space="map", later_ns=30_000_000),
    "predicted-auto": Kind(
        partial(autoware, name="PredictedObjects", package="autoware_auto_perception_msgs"),
        space="map",
    ),
    "detected": Kind(partial(autoware, name="DetectedObjects"), space="base_link", ids=False),
    "json": Kind(published, space="map", later_ns=-35_000_000),
}


def answer(
    kind: Kind,
    truth: Truth,
    boxes: Sequence[Box],
    frame: int,
    base_from_lidar: NDArray[np.float64],
) -> Written:
    """Write one answer of the detector."""
    stamp_ns = int(truth.stamp_ns[frame]) + kind.later_ns
    if kind.later_ns:
        placed = at_instant(truth, boxes, frame, stamp_ns)
        placed = placed if kind.space == "map" else in_space(placed, inverse(truth.pose(stamp_ns)))
    else:
        placed = in_cloud(truth, boxes, frame)
        if kind.space == "map":  # by the transform of the cloud's stamp, as a tracker does it
            placed = in_space(placed, truth.pose(stamp_ns))
        elif kind.space == "base_link":
            placed = in_space(placed, base_from_lidar)
    told = [
        Box(
            box.centre_m,
            box.size_m,
            box.yaw_rad,
            box.velocity_m_per_s if kind.velocity else None,
            box.score,
            box.class_name,
            box.track_id if kind.ids else "",
        )
        for box in placed
    ]
    return kind.write(told, stamp_ns=stamp_ns, frame_id=kind.space)


def read_base(folder: Path) -> NDArray[np.float64]:
    """Return base_link from the lidar, as the truth has it."""
    found: NDArray[np.float64] = np.load(folder / "poses.npz")["base_from_lidar"]
    return found


def write_copy(
    log: Path,
    out: Path,
    kind: Kind,
    truth: Truth,
    boxes: dict[int, list[Box]],
    base_from_lidar: NDArray[np.float64],
) -> None:
    """Copy a log, with the detector's output and, for boxes in the map, with /tf."""
    rows: list[tuple[int, str, Written]] = []
    for frame in sorted(boxes):
        written = answer(kind, truth, boxes[frame], frame, base_from_lidar)
        rows.append((int(truth.stamp_ns[frame]) + LATENCY_NS, TOPIC, written))
    if kind.space == "map":
        for time_ns in range(int(truth.stamp_ns[0]), int(truth.stamp_ns[-1]) + 10**8, 20_000_000):
            placed = truth.pose(time_ns) @ inverse(base_from_lidar)
            rows.append((time_ns, "/tf", _transform(placed, time_ns)))
    rows.sort(key=lambda row: row[0])
    out.parent.mkdir(parents=True, exist_ok=True)
    with log.open("rb") as source, out.open("wb") as target:
        writer = Writer(target, chunk_size=4 << 20)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}

        def put(topic: str, written: Written, time_ns: int) -> None:
            if topic not in channels:
                schema = writer.register_schema(
                    written.schema_name, written.schema_encoding, written.schema
                )
                channels[topic] = writer.register_channel(topic, written.message_encoding, schema)
            writer.add_message(channels[topic], time_ns, written.data, time_ns)

        for schema, channel, message in make_reader(source).iter_messages():
            while rows and rows[0][0] <= message.log_time:
                time_ns, topic, written = rows.pop(0)
                put(topic, written, time_ns)
            if schema is not None and not channel.topic.startswith("/camera"):
                original = Written(
                    channel.message_encoding,
                    schema.name,
                    schema.encoding,
                    schema.data,
                    message.data,
                )
                put(channel.topic, original, message.log_time)
        for time_ns, topic, written in rows:
            put(topic, written, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]


def _transform(placed: Any, time_ns: int) -> Written:
    from scipy.spatial.transform import Rotation

    rotation = dict(
        zip("xyzw", Rotation.from_matrix(placed[:3, :3]).as_quat().tolist(), strict=True)
    )
    message = {
        "transforms": [
            {
                "header": header(time_ns, "map"),
                "child_frame_id": "base_link",
                "transform": {"translation": xyz(placed[:3, 3]), "rotation": rotation},
            }
        ]
    }
    return ros2("tf2_msgs/msg/TFMessage", ROS2_DEFINITIONS["tf2_msgs/TFMessage"], message)


def mine(
    log: Path, *, predictions: str = "", recorded_topic: str = ""
) -> tuple[list[SceneScore], list[str]]:
    """Mine a log as `counterpoint score` does; the scores, and sentences about damage."""
    bucket, key = open_object(str(log))
    settings = MiningSettings(
        bucket="memory://",
        artifacts="memory://",
        grid=Grid(),
        supervised="recorded",
        predictions=predictions,
        recorded_topic=recorded_topic,
        odometry_topic="none",  # the reference odometry of the log is ground truth
    )
    said: list[str] = []
    recording = recording_of(key, bucket.list(prefix=key.rpartition("/")[0]))
    scores = list(
        score_recording(
            bucket, recording, settings, on_damage=lambda damage: said.append(damage.what)
        )
    )
    return scores, said


@dataclass(frozen=True)
class Judged:
    """Planted failures, and the tracks that mining found.

    Attributes:
        planted: Failures, as planted.
        found: For each, the greatest strength of a track on it; 0 where none is.
        tracks: Strength of every reported track, and what it is about: a planted failure, `real`
            for a mover without a box, or `other`.
    """

    planted: list[Planted]
    found: list[float]
    tracks: list[tuple[float, str, str, str]]


def judge(
    truth: Truth,
    planted: Sequence[Planted],
    boxes: dict[int, list[Box]],
    scores: Sequence[SceneScore],
    frames: range,
) -> Judged:
    """Compare the tracks of the records with what was planted."""
    found = [0.0] * len(planted)
    tracks: list[tuple[float, str, str, str]] = []
    for score in scores:
        headlines = {reason.track_id: reason.headline for reason in score.reasons}
        for track in score.tracks:
            at = track.strongest
            frame = int(np.argmin(np.abs(truth.stamp_ns - at.stamp_ns)))
            if frame not in frames or track.strength < WEAK:
                continue
            place = truth.pose(float(truth.stamp_ns[frame]) + 5e7) @ np.append(at.centre_m, 1.0)
            about = "other"
            for number, each in enumerate(planted):
                for target in _places(truth, each, boxes, frame):
                    if float(np.hypot(*(target[:2] - place[:2]))) < NEAR_M + target[3]:
                        found[number] = max(found[number], track.strength)
                        about = f"{each.kind} {each.track_id}"
            if about == "other" and _unboxed_mover(truth, boxes, frame, place):
                about = "real: mover without a box"
            tracks.append((track.strength, track.kind, about, headlines.get(track.track_id, "")))
    return Judged(list(planted), found, sorted(tracks, reverse=True))


def _places(
    truth: Truth, planted: Planted, boxes: dict[int, list[Box]], frame: int
) -> list[NDArray[np.float64]]:
    if not planted.first <= frame <= planted.last:
        return []
    if planted.kind == "ghost":
        name = f"t{planted.track_id}"
        return [
            np.array([*box.centre_m, box.size_m[0] / 2])
            for box in boxes[frame]
            if box.track_id == name
        ]
    return [
        np.array([*box.centre_m, box.size_m[0] / 2])
        for box in truth.boxes[frame]
        if box.track_id == planted.track_id
    ]


def _unboxed_mover(truth: Truth, boxes: dict[int, list[Box]], frame: int, place: Any) -> bool:
    boxed = {box.track_id for box in boxes[frame]}
    return any(
        box.moving
        and f"t{box.track_id}" not in boxed
        and float(np.hypot(*(box.centre_m[:2] - place[:2]))) < NEAR_M + box.size_m[0] / 2
        for box in truth.boxes[frame]
    )


def main(arguments: Sequence[str]) -> None:
    """Write, mine and judge each kind of message."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--seeds", default="1")
    parser.add_argument("--frames", default="28:56")
    given = parser.parse_args(arguments)
    base_from_lidar = read_base(given.truth)
    truth = read_truth(given.truth)
    frames = range(*map(int, given.frames.split(":")))
    for seed in map(int, given.seeds.split(",")):
        rng = np.random.default_rng(seed)
        planted = plant(truth, rng, frames)
        boxes = detector_boxes(truth, planted, rng)
        for name in given.kinds.split(","):
            out = given.out / f"seed-{seed}" / name / "pandaset-002.mcap"
            write_copy(given.log, out, KINDS[name], truth, boxes, base_from_lidar)
            scores, said = mine(out)
            judged = judge(truth, planted, boxes, scores, frames)
            report(name, seed, judged, said, scores)
            (out.parent / "judged.json").write_text(json.dumps(asdict(judged), indent=1))


def report(
    name: str, seed: int, judged: Judged, said: Sequence[str], scores: Sequence[SceneScore]
) -> None:
    """Print one line of figures, the planted failures, and the tracks that are none of them."""
    by_kind: dict[str, list[bool]] = {}
    for each, strength in zip(judged.planted, judged.found, strict=True):
        by_kind.setdefault(each.kind, []).append(strength >= WEAK)
    figures = ", ".join(f"{kind} {sum(hits)}/{len(hits)}" for kind, hits in by_kind.items())
    others = [each for each in judged.tracks if each[2] == "other"]
    print(f"{name} seed {seed}: {figures}; tracks {len(judged.tracks)}, other {len(others)}")  # noqa: T201
    for each, strength in zip(judged.planted, judged.found, strict=True):
        print(f"    {each.kind} {each.track_id} {each.first}-{each.last}: {strength:.3f}")  # noqa: T201
    for strength, kind, about, headline in judged.tracks[:14]:
        print(f"      {strength:.3f} {kind} {about}: {headline}")  # noqa: T201
    for sentence in said:
        print(f"    said: {sentence}")  # noqa: T201
    compared = [f"{score.compared_share:.2f}" for score in scores]
    print(f"    compared {compared}")  # noqa: T201


if __name__ == "__main__":
    main(sys.argv[1:])
