"""The camera image of a frame: the right camera, the right moment, the points where they belong."""

import json
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from mcap_ros2._dynamic import serialize_dynamic
from PIL import Image

from schemas.arrays import NS_PER_S
from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.recordings import group_recordings
from schemas.work import Recording
from workers.ingest.camera import CameraReader, CameraUnavailableError
from workers.ingest.camera_model import CameraView, distort
from workers.ingest.ros_definitions import ROS2_DEFINITIONS
from workers.ingest.transforms import TransformTree, rigid

STAMP_NS = 1_700_000_000 * NS_PER_S
LIDAR = "/lidar/points"

FORWARD = (-0.5, 0.5, -0.5, 0.5)
"""Quaternion x y z w of a camera that looks along the lidar's x: lidar_from_camera."""
REAR = (0.5, 0.5, -0.5, -0.5)


@dataclass
class Log:
    """An MCAP file under construction."""

    out: BytesIO = field(default_factory=BytesIO)
    channels: dict[str, tuple[int, Callable[[Any], bytes]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.writer = Writer(self.out)
        self.writer.start()

    def ros(self, topic: str, kind: str, message: Mapping[str, Any], *, log_time_ns: int) -> None:
        if topic not in self.channels:
            text = ROS2_DEFINITIONS[kind]
            schema = self.writer.register_schema(
                kind.replace("/", "/msg/"), "ros2msg", text.encode()
            )
            channel = self.writer.register_channel(topic, "cdr", schema)
            self.channels[topic] = channel, serialize_dynamic(kind, text)[kind]
        self.add(topic, message, log_time_ns)

    def foxglove(self, topic: str, kind: str, message: Mapping[str, Any], *, at_ns: int) -> None:
        if topic not in self.channels:
            schema = self.writer.register_schema(kind, "jsonschema", b"{}")
            channel = self.writer.register_channel(topic, "json", schema)
            self.channels[topic] = channel, lambda value: json.dumps(value).encode()
        self.add(topic, message, at_ns)

    def add(self, topic: str, message: Mapping[str, Any], log_time_ns: int) -> None:
        channel, encode = self.channels[topic]
        self.writer.add_message(channel, log_time_ns, encode(message), log_time_ns)

    def cloud(self, stamp_ns: int, *, sweep_ns: Sequence[int] = (0, 0, 0)) -> None:
        """Write three points, ahead, left and behind, taken at these times after the stamp."""
        points = np.zeros(3, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4")])
        points["x"], points["y"], points["t"] = (10, 0, -10), (0, 10, 0), sweep_ns
        self.ros(
            LIDAR,
            "sensor_msgs/PointCloud2",
            {
                "header": header(stamp_ns, "lidar"),
                "height": 1,
                "width": 3,
                "fields": [
                    {"name": name, "offset": 4 * i, "datatype": 6 if name == "t" else 7, "count": 1}
                    for i, name in enumerate("xyzt")
                ],
                "is_bigendian": False,
                "point_step": 16,
                "row_step": 48,
                "data": points.tobytes(),
                "is_dense": True,
            },
            log_time_ns=stamp_ns,
        )

    def image(self, camera: str, stamp_ns: int, *, data: bytes | None = None) -> None:
        self.ros(
            f"/{camera}/image/compressed",
            "sensor_msgs/CompressedImage",
            {"header": header(stamp_ns, camera), "format": "png", "data": data or picture()},
            log_time_ns=stamp_ns,
        )

    def info(self, camera: str, stamp_ns: int, **change: Any) -> None:
        self.ros(
            f"/{camera}/camera_info",
            "sensor_msgs/CameraInfo",
            {
                "header": header(stamp_ns, camera),
                "width": 64,
                "height": 48,
                "distortion_model": "plumb_bob",
                "d": [0.0] * 5,
                "k": [50.0, 0, 32, 0, 50, 24, 0, 0, 1],
                "r": [1.0, 0, 0, 0, 1, 0, 0, 0, 1],
                "p": [50.0, 0, 32, 0, 0, 50, 24, 0, 0, 0, 1, 0],
                "binning_x": 0,
                "binning_y": 0,
                "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
            }
            | change,
            log_time_ns=stamp_ns,
        )

    def transforms(
        self, *stated: tuple[str, str, Sequence[float], Sequence[float]], topic: str = "/tf_static"
    ) -> None:
        self.ros(
            topic,
            "tf2_msgs/TFMessage",
            {
                "transforms": [
                    {
                        "header": header(STAMP_NS, parent),
                        "child_frame_id": child,
                        "transform": {
                            "translation": dict(zip("xyz", translation, strict=True)),
                            "rotation": dict(zip("xyzw", rotation, strict=True)),
                        },
                    }
                    for parent, child, translation, rotation in stated
                ]
            },
            log_time_ns=STAMP_NS,
        )

    def recording(self) -> tuple[Bucket, Recording]:
        self.writer.finish()  # type: ignore[no-untyped-call]
        bucket = open_bucket("memory://")
        bucket.put("log.mcap", self.out.getvalue())
        return bucket, group_recordings(bucket.list())[0]


def header(stamp_ns: int, frame_id: str) -> dict[str, Any]:
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame_id}


def picture(width: int = 64, height: int = 48) -> bytes:
    out = BytesIO()
    Image.new("RGB", (width, height), (90, 120, 200)).save(out, format="PNG")
    return out.getvalue()


def camera_log(camera: str, *, image: bytes | None = None, **info: Any) -> Log:
    """Write one lidar and one camera half a metre ahead of it, looking ahead."""
    log = Log()
    log.cloud(STAMP_NS)
    log.image(camera, STAMP_NS, data=image)
    log.info(camera, STAMP_NS, **info)
    log.transforms(("lidar", camera, (0.5, 0, 0), FORWARD))
    return log


def usual_log() -> Log:
    return camera_log("front")


def views_of(log: Log, *, stamp_ns: int = STAMP_NS) -> list[CameraView]:
    bucket, recording = log.recording()
    return CameraReader(bucket, recording, lidar_topic=LIDAR).views_at(stamp_ns)


def view_of(log: Log, *, stamp_ns: int = STAMP_NS) -> CameraView:
    (view,) = views_of(log, stamp_ns=stamp_ns)
    return view


def points(*rows: Sequence[float]) -> Any:
    return np.array(rows, dtype=np.float32)


def test_a_point_ahead_lies_in_the_middle_of_the_image_and_one_to_the_left_lies_left() -> None:
    view = view_of(usual_log())
    pixels, seen_mask = view.project(points((10.5, 0, 0), (10.5, 2, 0), (10.5, 0, 2)))
    assert seen_mask.all()
    np.testing.assert_allclose(pixels, [(32, 24), (22, 24), (32, 14)], atol=1e-9)
    assert (view.width, view.height, view.image_format) == (64, 48, "png")


def test_points_behind_the_camera_or_outside_the_image_are_not_seen() -> None:
    view = view_of(usual_log())
    _, seen_mask = view.project(points((-10, 0, 0), (0.5, 0, 0), (10.5, 20, 0), (10.5, 0, -20)))
    assert not seen_mask.any()


def test_transforms_are_chained_through_the_spaces_between() -> None:
    log = Log()
    log.cloud(STAMP_NS)
    log.image("front", STAMP_NS)
    log.info("front", STAMP_NS)
    log.transforms(
        ("base", "/lidar", (1, 0, 2), (0, 0, 0, 1)),
        ("base", "mast", (1.5, 0, 2), (0, 0, 0, 0)),
        ("mast", "front", (0, 0, 0), FORWARD),
    )
    pixels, _ = view_of(log).project(points((10.5, 2, 0)))
    np.testing.assert_allclose(pixels, [(22, 24)], atol=1e-9)


def test_the_image_is_the_one_taken_when_the_lidar_swept_over_its_view() -> None:
    log = Log()
    for i in range(5):
        log.cloud(STAMP_NS + i * 100_000_000, sweep_ns=(50_000_000, 25_000_000, 100_000_000))
    for i in range(-1, 6):
        log.image("front", STAMP_NS + 52_000_000 + i * 100_000_000)
        log.info("front", STAMP_NS + 52_000_000 + i * 100_000_000)
    log.transforms(("lidar", "front", (0.5, 0, 0), FORWARD))
    view = view_of(log, stamp_ns=STAMP_NS + 200_000_000)
    assert view.stamp_ns == STAMP_NS + 252_000_000


def test_without_point_times_the_image_is_the_one_nearest_to_the_stamp() -> None:
    log = usual_log()
    for i in range(1, 5):
        log.image("front", STAMP_NS + i * 100_000_000)
    assert view_of(log, stamp_ns=STAMP_NS + 260_000_000).stamp_ns == STAMP_NS + 300_000_000


def test_every_calibrated_camera_has_a_view() -> None:
    log = usual_log()
    log.image("rear", STAMP_NS)
    log.info("rear", STAMP_NS)
    log.transforms(("lidar", "rear", (-0.5, 0, 0), REAR))
    log.image("unplaced", STAMP_NS)
    front, rear = views_of(log)
    assert (front.topic, rear.topic) == ("/front/image/compressed", "/rear/image/compressed")
    pixels, seen_mask = rear.project(points((-10.5, 2, 0)))
    assert seen_mask.all()
    np.testing.assert_allclose(pixels, [(42, 24)], atol=1e-9)


def test_a_calibration_for_a_larger_image_is_scaled() -> None:
    view = view_of(camera_log("front", image=picture(32, 24)))
    np.testing.assert_allclose(view.project(points((10.5, 2, 0)))[0], [(11, 12)], atol=1e-9)


def test_a_lens_bends_only_images_that_are_not_rectified() -> None:
    lens = [-0.3, 0.1, 0.0, 0.0, 0.0]
    raw = view_of(camera_log("front", d=lens)).project(points((10.5, 5, 0)))[0]
    stretch = 1 - 0.3 * 0.25 + 0.1 * 0.0625
    np.testing.assert_allclose(raw, [(32 - 25 * stretch, 24)], atol=1e-9)
    rectified = view_of(camera_log("front_rect", d=lens)).project(points((10.5, 5, 0)))[0]
    np.testing.assert_allclose(rectified, [(7, 24)], atol=1e-9)


def test_foxglove_in_json_is_read_with_the_pose_of_its_cloud() -> None:
    log = Log()
    time = {"sec": STAMP_NS // NS_PER_S, "nsec": 0}
    cloud = points((10, 0, 0)).tobytes()
    axes = [{"name": name, "offset": 4 * i, "type": 7} for i, name in enumerate("xyz")]
    turned = {"x": 0, "y": 0, "z": 1, "w": 1}
    log.foxglove(
        LIDAR,
        "foxglove.PointCloud",
        {
            "timestamp": time,
            "frame_id": "base",
            "pose": {"position": {"x": 0, "y": 0, "z": 0}, "orientation": turned},
            "point_stride": 12,
            "fields": axes,
            "data": b64encode(cloud).decode(),
        },
        at_ns=STAMP_NS,
    )
    log.foxglove(
        "/front/image",
        "foxglove.CompressedImage",
        {
            "timestamp": time,
            "frame_id": "front",
            "format": "png",
            "data": b64encode(picture()).decode(),
        },
        at_ns=STAMP_NS,
    )
    log.foxglove(
        "/front/calibration",
        "foxglove.CameraCalibration",
        {
            "timestamp": time,
            "frame_id": "front",
            "width": 64,
            "height": 48,
            "distortion_model": "",
            "D": [],
            "K": [50, 0, 32, 0, 50, 24, 0, 0, 1],
            "R": [],
            "P": [],
        },
        at_ns=STAMP_NS,
    )
    log.foxglove(
        "/tf",
        "foxglove.FrameTransform",
        {
            "timestamp": time,
            "parent_frame_id": "base",
            "child_frame_id": "front",
            "translation": {"x": 0, "y": 0, "z": 0},
            "rotation": dict(zip("xyzw", FORWARD, strict=True)),
        },
        at_ns=STAMP_NS,
    )
    # The cloud is turned a quarter to the left: what lies to its right lies ahead of the camera.
    pixels, seen_mask = view_of(log).project(points((0, -10, 0), (10, 0, 0)))
    assert seen_mask.tolist() == [True, False]
    np.testing.assert_allclose(pixels[0], (32, 24), atol=1e-9)


def without(what: str) -> Log:
    log = Log()
    if what != "cloud":
        log.cloud(STAMP_NS)
    if what != "image":
        log.image("front", STAMP_NS + (2 * NS_PER_S if what == "near" else 0))
    if what != "info":
        log.info("front", STAMP_NS)
    if what != "transform":
        log.transforms(("lidar", "front", (0.5, 0, 0), FORWARD))
    return log


@pytest.mark.parametrize(
    ("log", "why"),
    [
        (without("cloud"), "no cloud of /lidar/points can be read"),
        (without("image"), "no topic holds compressed images"),
        (without("info"), "/front/image/compressed has no calibration"),
        (without("transform"), "not tied to the lidar: no transform from 'lidar' to 'front'"),
        (without("near"), "has its nearest image 2.0 s from the frame"),
    ],
    ids=["cloud", "image", "calibration", "transform", "image in time"],
)
def test_what_is_missing_is_said(log: Log, why: str) -> None:
    with pytest.raises(CameraUnavailableError, match=why) as caught:
        view_of(log)
    assert "log" in str(caught.value)


def test_an_image_that_is_none_is_said() -> None:
    with pytest.raises(CameraUnavailableError, match="format 'png' that cannot be read"):
        view_of(camera_log("front", image=b"no picture"))


def test_an_uncalibrated_camera_is_said() -> None:
    with pytest.raises(CameraUnavailableError, match="without focal lengths"):
        view_of(camera_log("front", k=[0.0] * 9, p=[0.0] * 12))


def test_distortion_bends_rays_as_its_model_says() -> None:
    rays = np.array([(0.0, 0.0), (0.5, 0.0), (0.0, -0.5)])
    np.testing.assert_allclose(
        distort(rays, (0.1, 0.0, 0.0, 0.0, 0.0), model="plumb_bob"),
        rays * (1 + 0.1 * 0.25),
    )
    tangential = distort(rays, (0.0, 0.0, 0.01, 0.02), model="plumb_bob")
    np.testing.assert_allclose(tangential[1], (0.5 + 0.02 * 0.75, 0.01 * 0.25))
    rational = distort(rays, (0.0,) * 5 + (0.2,), model="rational_polynomial")
    np.testing.assert_allclose(rational[1], (0.5 / 1.05, 0))
    fisheye = distort(rays, (0.0,) * 4, model="equidistant")
    np.testing.assert_allclose(fisheye[1], (np.arctan(0.5), 0))
    np.testing.assert_allclose(fisheye[0], (0, 0))


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_rays_beyond_where_the_polynomial_turns_back_do_not_enter_the_image(model: str) -> None:
    far = distort(np.array([(0.2, 0.0), (4.0, 0.0)]), (-0.4, 0.0, 0.0, 0.0), model=model)
    assert np.isfinite(far[0]).all()
    assert np.isinf(far[1, 0])


def test_a_tree_of_transforms_answers_both_ways_and_knows_what_it_does_not() -> None:
    tree = TransformTree()
    quarter = rigid((1.0, 2.0, 3.0), (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)))
    tree.add(parent="base", child="lidar", parent_from_child=quarter)
    base_from_lidar = tree.find(to="base", source="lidar")
    lidar_from_base = tree.find(to="lidar", source="base")
    assert base_from_lidar is not None
    assert lidar_from_base is not None
    np.testing.assert_allclose(base_from_lidar @ (1, 0, 0, 1), (1, 3, 3, 1))
    np.testing.assert_allclose(base_from_lidar @ lidar_from_base, np.eye(4), atol=1e-12)
    assert tree.find(to="base", source="camera") is None


@pytest.mark.reference
@pytest.mark.parametrize(
    ("log", "topic", "apart_ms"),
    [
        ("pandaset/panda-01/2019-05-11/pandaset-002", "/lidar/top/points", 51.5),
        ("kitti360/annieway-360/2013-05-28/kitti360-3000", "/velodyne_points", -0.7),
    ],
)
def test_real_logs_show_the_image_of_their_frame_and_thousands_of_points_in_it(
    reference: Path, log: str, topic: str, apart_ms: float
) -> None:
    bucket = open_bucket(str(reference / "data" / "logs"))
    recording = next(each for each in group_recordings(bucket.list()) if each.log_id == log)
    truth = reference / "data" / "truth" / f"{Path(recording.parts[-1].key).with_suffix('')}"
    stamp_ns = json.loads((truth / "frames.json").read_text())["frames"][10]["header_stamp"]
    (view,) = CameraReader(bucket, recording, lidar_topic=topic).views_at(stamp_ns)
    assert (view.stamp_ns - stamp_ns) / 1e6 == pytest.approx(apart_ms, abs=1.5)
    with Image.open(BytesIO(view.image_bytes)) as image:
        assert image.size == (view.width, view.height)
    ahead = np.random.default_rng(0).uniform((5, -3, -1), (30, 3, 1), (1000, 3))
    _, seen_mask = view.project(ahead.astype(np.float32))
    assert seen_mask.mean() > 0.8
