"""An excerpt keeps the rules that Encord publishes for MCAP scenes, whatever log it is cut from."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2._dynamic import serialize_dynamic

from schemas.excerpt import ExcerptMessage
from tests.encord_rules import OVERLAY, broken_rules
from tests.export_world import FRAMES, LOG_ID, STEP_NS, ExportWorld, record, rows
from tests.tiny_logs import BEGIN_NS, LIDAR, cloud
from workers.excerpt import writing
from workers.ingest.ros_definitions import ROS2_DEFINITIONS

CAMERA = "/camera/front/image/compressed"
TYPES = {
    LIDAR: "sensor_msgs/PointCloud2",
    CAMERA: "sensor_msgs/CompressedImage",
    "/tf_static": "tf2_msgs/TFMessage",
    "/tf": "tf2_msgs/TFMessage",
}
DELAY_NS = 5_000_000
"""A message is logged so long after it was measured."""


def encoded(kind: str, message: Mapping[str, Any]) -> bytes:
    name = kind.replace("/", "/msg/")
    return bytes(serialize_dynamic(name, ROS2_DEFINITIONS[kind])[name](message))


def header(at_ns: int, frame: str) -> dict[str, Any]:
    seconds, nanos = divmod(at_ns, 1_000_000_000)
    return {"stamp": {"sec": seconds, "nanosec": nanos}, "frame_id": frame}


def transforms(at_ns: int, *pairs: tuple[str, str]) -> bytes:
    """Return transforms of these pairs of parent and child."""
    turned = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    moved = {"x": 1.0, "y": 0.0, "z": 1.8}
    placed = [
        {
            "header": header(at_ns, parent),
            "child_frame_id": child,
            "transform": {"translation": moved, "rotation": turned},
        }
        for parent, child in pairs
    ]
    return encoded("tf2_msgs/TFMessage", {"transforms": placed})


def recorded(*, static_at: int = 0) -> Iterable[tuple[str, int, bytes]]:
    """Yield topic, log time and payload of a car with a lidar, a camera and its pose.

    Args:
        static_at: Number of the frame before which the static transforms are recorded.
    """
    for number in range(60):
        at_ns = BEGIN_NS + number * STEP_NS
        if number == static_at:
            placed = transforms(at_ns, ("base_link", "lidar"), ("base_link", "camera_front"))
            yield "/tf_static", at_ns, placed
        yield LIDAR, at_ns, cloud(at_ns, rows(number).tobytes(), ("x", "y", "z", "intensity"))
        image = {"header": header(at_ns, "camera_front"), "format": "jpeg", "data": b"\xff\xd8"}
        yield CAMERA, at_ns + DELAY_NS, encoded("sensor_msgs/CompressedImage", image)
        yield "/tf", at_ns + 2 * DELAY_NS, transforms(at_ns, ("map", "base_link"))


def write_car(folder: Path, *, static_at: int = 0, **options: Any) -> ExportWorld:
    """Write the log with these options of the writer, and return the world around it."""
    path = folder / f"{LOG_ID}.mcap"
    path.parent.mkdir(parents=True)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4000, **options)
        writer.start(profile="ros2", library="test")
        ids = {}
        for topic, kind in TYPES.items():
            text = ROS2_DEFINITIONS[kind].encode()
            schema = writer.register_schema(kind.replace("/", "/msg/"), "ros2msg", text)
            ids[topic] = writer.register_channel(topic, "cdr", schema)
        for topic, at_ns, data in recorded(static_at=static_at):
            writer.add_message(ids[topic], at_ns + DELAY_NS, data, at_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return ExportWorld(folder)


def exported(world: ExportWorld, out: Path, *, scenes: int = 1) -> list[Path]:
    report = world.export(world.selection(scenes=scenes), "mcap", out)
    assert report.missing == {}
    return [out / each.place for each in report.written.values()]


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.LZ4},
        {"use_chunking": False},
        {"use_statistics": False, "index_types": IndexType.NONE},
        {"repeat_schemas": False, "repeat_channels": False, "use_summary_offsets": False},
        {"static_at": 19},
        {"static_at": 22},
        {"static_at": 55},
    ],
    ids=[
        *("lz4", "no chunks", "no indexes", "no channels in the summary"),
        *("transforms before the first frame", "in the scene", "after the excerpt"),
    ],
)
def test_an_excerpt_keeps_every_rule_however_the_log_was_written(
    options: dict[str, Any], tmp_path: Path
) -> None:
    (path,) = exported(write_car(tmp_path / "logs", **options), tmp_path / "out")
    assert broken_rules(path) == []


def test_transforms_are_copied_once_where_that_is_enough(tmp_path: Path) -> None:
    times = {}
    for static_at in (0, 19, 22, 55):
        world = write_car(tmp_path / f"{static_at}", static_at=static_at)
        (path,) = exported(world, tmp_path / f"out-{static_at}")
        with path.open("rb") as file:
            found = make_reader(file).iter_messages(topics=["/tf_static"])
            seconds = [(m.log_time - record().start_ns) / 1e9 for _, _, m in found]
            times[static_at] = [round(each, 1) for each in seconds]
    assert times == {0: [-1.0], 19: [-0.1], 22: [-1.0, 0.2], 55: [-1.0]}


def test_each_scene_is_one_file_of_its_own_time(tmp_path: Path) -> None:
    paths = exported(write_car(tmp_path / "logs"), tmp_path / "out", scenes=3)
    assert len({path.name for path in paths}) == 3
    for number, path in enumerate(paths):
        assert broken_rules(path) == []
        with path.open("rb") as file:
            shown = [m.log_time for _, _, m in make_reader(file).iter_messages(topics=[OVERLAY])]
        start_ns = record(number).start_ns
        assert shown == [start_ns + DELAY_NS + step * STEP_NS for step in range(FRAMES)]


def test_labels_by_log_time_find_the_recorded_cloud_and_its_points(tmp_path: Path) -> None:
    (path,) = exported(write_car(tmp_path / "logs"), tmp_path / "out")
    with path.open("rb") as file:
        found = [(c.topic, m.log_time) for _, c, m in make_reader(file).iter_messages()]
    ours = {at_ns for topic, at_ns in found if topic == OVERLAY}
    assert len(ours) == FRAMES
    assert all(found.count((LIDAR, at_ns)) == 1 for at_ns in ours)


Edit = Callable[[list[ExcerptMessage]], list[ExcerptMessage]]


def only(*topics: str) -> Edit:
    return lambda messages: [m for m in messages if m.channel.topic in topics]


def without(topic: str) -> Edit:
    return lambda messages: [m for m in messages if m.channel.topic != topic]


def turned(messages: list[ExcerptMessage]) -> list[ExcerptMessage]:
    return messages[::-1]


def doubled(messages: list[ExcerptMessage]) -> list[ExcerptMessage]:
    return [m for m in messages for _ in range(1 + (m.channel.topic == OVERLAY))]


def at_zero(messages: list[ExcerptMessage]) -> list[ExcerptMessage]:
    return [replace(messages[0], log_time_ns=0), *messages[1:]]


def unexplained(messages: list[ExcerptMessage]) -> list[ExcerptMessage]:
    unknown = replace(messages[0].channel, schema_name="", schema_data=b"")
    return [
        replace(m, channel=unknown) if m.channel == messages[0].channel else m for m in messages
    ]


@pytest.mark.parametrize(
    ("edit", "sentence"),
    [
        (without("/tf_static"), "no transform connects"),
        (only("/tf_static", "/tf"), "no topic has a schema of point clouds"),
        (without(LIDAR), "at which nothing was recorded"),
        (turned, "not in the order of their log times"),
        (doubled, "two clouds at one log time"),
        (at_zero, "much longer than its clouds"),
        (unexplained, "/tf_static has no schema"),
    ],
)
def test_a_file_that_breaks_a_rule_is_found(
    edit: Edit, sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = writing.write_mcap

    def edited(path: Path, messages: Iterable[ExcerptMessage], **rest: Any) -> None:
        original(path, edit(list(messages)), **rest)

    monkeypatch.setattr("workers.excerpt.source.write_mcap", edited)
    (path,) = exported(write_car(tmp_path / "logs"), tmp_path / "out")
    assert any(sentence in each for each in broken_rules(path))


def test_a_file_without_chunks_is_found(tmp_path: Path) -> None:
    world = write_car(tmp_path / "logs", use_chunking=False)
    assert broken_rules(world.bucket / f"{LOG_ID}.mcap") == [
        "the file has no summary with chunk indexes"
    ]
