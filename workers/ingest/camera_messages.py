"""Camera messages: images and calibrations in the types of ROS and Foxglove."""

from base64 import b64decode
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.work import Channel
from workers.ingest.decoding import MessageUnreadableError, can_decode, decode_message
from workers.ingest.messages import RawMessage
from workers.ingest.transforms import member

_NOT_AS_TYPED: Final = (
    KeyError,
    AttributeError,
    TypeError,
    ValueError,
    IndexError,
    OverflowError,  # numbers in JSON beyond any float
)


@dataclass(frozen=True, slots=True, eq=False)
class CameraImage:
    """One compressed image.

    Attributes:
        topic: MCAP topic.
        frame_id: Space of the camera, by the log's own name.
        stamp_ns: Of its header, else its log time.
        data: As recorded, compressed.
        format: As recorded: `jpeg`, `png`.
    """

    topic: str
    frame_id: str
    stamp_ns: int
    data: bytes
    format: str


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Projection of a camera from its space to pixels.

    Attributes:
        topic: MCAP topic.
        frame_id: Space of the camera, by the log's own name.
        width: Pixels of the calibrated image; 0 where not stated.
        height: Pixels of the calibrated image; 0 where not stated.
        distortion_model: ROS's name.
        distortion: Coefficients of the lens.
        intrinsics: (3, 3) K, for the raw image.
        projection: (3, 4) P, for the rectified image; zero where not stated.
    """

    topic: str
    frame_id: str
    width: int
    height: int
    distortion_model: str
    distortion: tuple[float, ...]
    intrinsics: NDArray[np.float64]
    projection: NDArray[np.float64]


def has_images(channel: Channel) -> bool:
    """Return True for a channel of compressed images that can be read here."""
    return can_decode(
        channel, ros="sensor_msgs/CompressedImage", foxglove="foxglove.CompressedImage"
    )


def has_calibrations(channel: Channel) -> bool:
    """Return True for a channel of camera calibrations that can be read here."""
    return can_decode(channel, ros="sensor_msgs/CameraInfo", foxglove="foxglove.CameraCalibration")


def camera_image(message: RawMessage) -> CameraImage:
    """Decode an image.

    Raises:
        MessageUnreadableError: If the message is no image.
    """
    decoded = decode_message(message)
    try:
        frame_id, stamp_ns = frame_and_stamp(decoded)
        data = member(decoded, "data")
        return CameraImage(
            topic=message.channel.topic,
            frame_id=frame_id,
            stamp_ns=stamp_ns or message.log_time_ns,
            data=b64decode(data, validate=True) if isinstance(data, str) else bytes(data),
            format=str(member(decoded, "format")),
        )
    except _NOT_AS_TYPED as error:
        raise _unreadable(message, error) from error


def calibration(message: RawMessage) -> Calibration:
    """Decode a calibration.

    Raises:
        MessageUnreadableError: If the message is no calibration, or its matrices are invalid.
    """
    decoded = decode_message(message)
    try:
        frame_id, _ = frame_and_stamp(decoded)
        intrinsics = np.array(_either(decoded, "K"), dtype=np.float64).reshape(3, 3)
        stated = np.array(_either(decoded, "P"), dtype=np.float64)
        projection = stated.reshape(3, 4) if stated.size else np.zeros((3, 4))
        if not (np.isfinite(intrinsics).all() and np.isfinite(projection).all()):
            raise ValueError("matrices with numbers that are not finite")
        return Calibration(
            topic=message.channel.topic,
            frame_id=frame_id,
            width=int(member(decoded, "width")),
            height=int(member(decoded, "height")),
            distortion_model=str(member(decoded, "distortion_model")),
            distortion=tuple(float(each) for each in _either(decoded, "D")),
            intrinsics=intrinsics,
            projection=projection,
        )
    except _NOT_AS_TYPED as error:
        raise _unreadable(message, error) from error


def frame_and_stamp(decoded: Any) -> tuple[str, int]:
    """Read a ROS header, or Foxglove's frame and timestamp."""
    if hasattr(decoded, "header"):
        stamp = decoded.header.stamp
        seconds = stamp.sec if hasattr(stamp, "sec") else stamp.secs
        nanoseconds = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsecs
        return decoded.header.frame_id, seconds * NS_PER_S + nanoseconds
    stamp = member(decoded, "timestamp")
    if isinstance(stamp, dict):
        return str(decoded["frame_id"]), int(stamp["sec"]) * NS_PER_S + int(stamp["nsec"])
    return decoded.frame_id, stamp.seconds * NS_PER_S + stamp.nanos


def _either(decoded: Any, name: str) -> Any:
    """Read a matrix, whose name is in lower case in ROS 2 and in upper case elsewhere."""
    if isinstance(decoded, dict):
        return decoded.get(name, [])
    return getattr(decoded, name) if hasattr(decoded, name) else getattr(decoded, name.lower())


def _unreadable(message: RawMessage, error: Exception) -> MessageUnreadableError:
    return MessageUnreadableError(
        f"cannot read {message.channel.schema_name}: {type(error).__name__}: {error} "
        f"({message.channel.topic}, logged at {message.log_time_ns})"
    )
