"""Excerpt of a log around a scene: its raw messages, and the clouds that are the scene's frames.

`service.export` writes labelled data from it and knows no MCAP; `workers.excerpt` cuts it.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from schemas.frame import LidarFrame
from schemas.overlay import Overlay
from schemas.score import SceneScore


@dataclass(frozen=True, slots=True, eq=False)
class ExcerptChannel:
    """A topic as recorded, with everything that a copy of its messages needs.

    Attributes:
        topic: Its name.
        message_encoding: `cdr`, `ros1`, `protobuf`, `json` or another one.
        schema_name: Type of its messages; empty without a schema.
        schema_encoding: Encoding of the schema.
        schema_data: Bytes of the schema, unchanged.
        metadata: Of the channel, such as the quality of service of ROS 2.
    """

    topic: str
    message_encoding: str
    schema_name: str
    schema_encoding: str
    schema_data: bytes
    metadata: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class SceneCloud:
    """One frame of a scene, read from the log again.

    Attributes:
        number: Index of the frame in the scene, and in its overlay.
        frame: The points; point i of the message is point i of the frame.
        frame_id: The space of the points, by the log's own name.
    """

    number: int
    frame: LidarFrame
    frame_id: str


@dataclass(frozen=True, slots=True, eq=False)
class ExcerptMessage:
    """A message, byte for byte.

    Attributes:
        channel: Its topic.
        log_time_ns: Its log time, nanoseconds since the Unix epoch.
        publish_time_ns: Its publish time.
        data: Its payload.
        cloud: The frame of the scene that this message is; None for all other messages.
    """

    channel: ExcerptChannel
    log_time_ns: int
    publish_time_ns: int
    data: bytes
    cloud: SceneCloud | None = None


class LogExcerpt(Protocol):
    """Interface of the part of a log that shows one scene."""

    @property
    def metadata(self) -> Iterable[tuple[str, Mapping[str, str]]]:
        """Metadata records of the log: name and content, such as its licence."""
        ...

    def messages(self) -> Iterator[ExcerptMessage]:
        """Yield lidar, transforms, motion and cameras around the scene, in the order of log times.

        Raises:
            PermanentError: If the log no longer has the frames of the scene.
        """
        ...

    def clouds(self) -> Iterator[SceneCloud]:
        """Yield the frames of the scene in order, all of them.

        Raises:
            PermanentError: If the log no longer has the frames of the scene.
        """
        ...


class ExcerptSource(Protocol):
    """Interface of what opens logs and writes excerpts."""

    def cut(self, score: SceneScore, overlay: Overlay) -> LogExcerpt:
        """Find the log of a scene.

        Raises:
            PermanentError: If the log is gone, or is no MCAP file.
        """
        ...

    def write_mcap(
        self,
        path: Path,
        messages: Iterable[ExcerptMessage],
        *,
        metadata: Iterable[tuple[str, Mapping[str, str]]],
        attachments: Iterable[tuple[str, str, bytes]],
    ) -> None:
        """Write an MCAP file with chunks, indexes and a summary.

        Args:
            path: The file.
            messages: Its messages.
            metadata: Name and content of each metadata record.
            attachments: Name, media type and bytes of each attachment.
        """
        ...
