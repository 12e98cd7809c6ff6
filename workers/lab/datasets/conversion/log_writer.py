"""MCAP writer of a converted log: clouds, poses, transforms and images as ROS 2 records them."""

from typing import IO, Any, Final

from mcap_ros2.writer import Writer

from schemas.arrays import Transform
from workers.ingest.ros_definitions import ROS2_DEFINITIONS
from workers.lab.datasets.conversion.messages import (
    camera_info_of,
    image_of,
    odometry_of,
    transforms_of,
)
from workers.lab.datasets.conversion.source import (
    CameraModel,
    DatasetUnusableError,
    Picture,
    SourceFrame,
    SourceLog,
)
from workers.lab.simulation.output.cloud import (
    POINT_CLOUD2,
    POINT_CLOUD2_DEFINITION,
    STAMP_DEFINITION,
    message_of,
)

CHUNK_BYTES: Final = 4 << 20
"""Uncompressed size at which a chunk is closed, as in simulated logs."""

ODOMETRY_TOPIC: Final = "/reference/odometry"
STATIC_TOPIC: Final = "/tf_static"
BASE_SPACE: Final = "base_link"

_IMAGE_FORMS: Final = {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png"}


class LogWriter:
    """Writes the frames of one log to a stream.

    Args:
        stream: Stream of bytes.
        log: The log.
        about: Data set, licence and attribution, for the metadata of the file.
    """

    def __init__(self, stream: IO[bytes], log: SourceLog, about: dict[str, str]) -> None:
        self._log = log
        self._writer = Writer(stream, chunk_size=CHUNK_BYTES)
        self._schemas: dict[str, Any] = {}
        self._cameras = {camera.name: camera for camera in log.cameras}
        self._before: tuple[int, Transform] | None = None
        self._index = 0
        identity = {"vehicle": log.vehicle, "date": log.date, "software_version": ""}
        self._writer.add_metadata("counterpoint.log", identity)
        self._writer.add_metadata("dataset", about)

    def add(self, frame: SourceFrame) -> bytes:
        """Write a frame with its pose and images; return the packed points of its cloud."""
        if self._index == 0:
            self._write_static(frame.stamp_ns)
        for picture in frame.pictures:
            self._write_picture(picture)
        message = message_of(frame.rows, stamp_ns=frame.stamp_ns, space=self._log.space)
        self._write(self._log.topic, POINT_CLOUD2, message, frame.stamp_ns, self._index)
        if frame.world_from_sensor is not None:
            stated = odometry_of(
                frame.world_from_sensor,
                stamp_ns=frame.stamp_ns,
                space=self._log.space,
                since=self._before,
            )
            self._write(ODOMETRY_TOPIC, "nav_msgs/msg/Odometry", stated, frame.stamp_ns)
            self._before = (frame.stamp_ns, frame.world_from_sensor)
        self._index += 1
        data: bytes = message["data"]
        return data

    def finish(self) -> None:
        """Write the summary and close the file."""
        self._writer.finish()  # type: ignore[no-untyped-call]  # upstream lacks the return type

    def _write_static(self, stamp_ns: int) -> None:
        log = self._log
        stated = [(log.space, each.space, each.lidar_from_camera) for each in log.cameras]
        if log.base_from_lidar is not None:
            stated.insert(0, (BASE_SPACE, log.space, log.base_from_lidar))
        if stated:
            message = transforms_of(stated, stamp_ns=stamp_ns)
            self._write(STATIC_TOPIC, "tf2_msgs/msg/TFMessage", message, stamp_ns)

    def _write_picture(self, picture: Picture) -> None:
        camera: CameraModel = self._cameras[picture.camera]
        form = _IMAGE_FORMS.get(picture.path.suffix.lower())
        if form is None:
            raise DatasetUnusableError(f"no image that can be read, jpeg or png: {picture.path}")
        try:
            data = picture.path.read_bytes()
        except OSError as error:
            raise DatasetUnusableError(
                f"cannot read the image {picture.path}: {error.strerror}"
            ) from None
        stamp_ns, name = picture.stamp_ns, camera.name
        image = image_of(camera, data, stamp_ns=stamp_ns, form=form)
        info = camera_info_of(camera, stamp_ns=stamp_ns)
        kind = "sensor_msgs/msg/CompressedImage"
        self._write(f"/camera/{name}/image/compressed", kind, image, stamp_ns)
        self._write(f"/camera/{name}/camera_info", "sensor_msgs/msg/CameraInfo", info, stamp_ns)

    def _write(
        self, topic: str, kind: str, message: dict[str, Any], at_ns: int, sequence: int = 0
    ) -> None:
        if kind not in self._schemas:
            definition = POINT_CLOUD2_DEFINITION
            if kind != POINT_CLOUD2:
                definition = ROS2_DEFINITIONS[kind.replace("/msg/", "/")] + STAMP_DEFINITION
            self._schemas[kind] = self._writer.register_msgdef(kind, definition)
        self._writer.write_message(topic, self._schemas[kind], message, at_ns, at_ns, sequence)
