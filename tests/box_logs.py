"""Small logs with boxes: a ring of points seen all around, and messages of any type next to it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

from mcap.writer import Writer

from schemas.frame import LidarFrame
from schemas.transport.bucket import Bucket, open_bucket
from tests.box_messages import Box, Written, header, ros2, xyz
from tests.tiny_logs import BEGIN_NS, CLOUD_TYPE, LIDAR, only_recording, ring, settings
from workers.errors import LogUnusableError
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.ingest.ros_definitions import ROS2_DEFINITIONS

STEP_NS = 100_000_000
OBJECTS = "/objects"


@dataclass(frozen=True)
class Put:
    """One message, on its topic, at its log time."""

    topic: str
    log_time_ns: int
    written: Written


def stamp(number: float) -> int:
    return BEGIN_NS + round(number * STEP_NS)


def clouds(count: int = 20) -> list[Put]:
    text = ROS2_DEFINITIONS["sensor_msgs/PointCloud2"].encode()
    return [
        Put(
            LIDAR,
            stamp(number),
            Written("cdr", CLOUD_TYPE, "ros2msg", text, ring(stamp(number))),
        )
        for number in range(count)
    ]


def transform(
    parent: str, child: str, x_m: float, *, log_time_ns: int, topic: str = "/tf_static"
) -> Put:
    message = {
        "transforms": [
            {
                "header": header(log_time_ns, parent),
                "child_frame_id": child,
                "transform": {
                    "translation": xyz((x_m, 0, 0)),
                    "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
                },
            }
        ]
    }
    text = ROS2_DEFINITIONS["tf2_msgs/TFMessage"]
    return Put(topic, log_time_ns, ros2("tf2_msgs/msg/TFMessage", text, message))


def write(messages: Sequence[Put], *, classes: dict[str, dict[str, object]] | None = None) -> bytes:
    out = BytesIO()
    writer = Writer(out, chunk_size=60_000)
    writer.start(profile="ros2", library="test")
    if classes is not None:
        record = {key: json.dumps(value) for key, value in classes.items()}
        writer.add_metadata("counterpoint.classes", record)
    channels: dict[str, int] = {}
    for put in sorted(messages, key=lambda each: each.log_time_ns):
        if put.topic not in channels:
            schema = writer.register_schema(
                put.written.schema_name, put.written.schema_encoding, put.written.schema
            )
            encoding = put.written.message_encoding
            channels[put.topic] = writer.register_channel(put.topic, encoding, schema)
        writer.add_message(channels[put.topic], put.log_time_ns, put.written.data, put.log_time_ns)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def read(
    log: bytes, *, predictions: str = "", bucket: Bucket | None = None
) -> tuple[list[LidarFrame], list[str]]:
    """Read a log's frames with the model's answer, and what was said of it.

    Raises:
        LogUnusableError: If the log is refused.
    """
    bucket = bucket or open_bucket("memory://")
    bucket.put("fleet/drive.mcap", log)
    using = settings(supervised="recorded").model_copy(update={"predictions": predictions})
    recording = only_recording(bucket)
    plan = plan_recording(bucket, recording, using)
    if plan.refused:
        raise LogUnusableError(plan.refused)
    frames: list[LidarFrame] = []
    said: list[str] = []
    for shard in plan.shards:
        reader = read_shard(bucket, recording, shard, using)
        frames += reader.frames()
        said += [damage.what for damage in reader.damage]
    return frames, said


def boxes_at(x_m: float = 5.0, **changes: object) -> list[Box]:
    return [Box((x_m, 1.0, 0.0), **changes)]  # type: ignore[arg-type]
