"""Small MCAP logs for tests: a ring of points seen all around, written as a recorder would."""

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.writer import CompressionType, IndexType, Writer

from schemas.arrays import NS_PER_S
from schemas.mining import Grid, MiningSettings
from schemas.transport.bucket import Bucket
from schemas.transport.recordings import group_recordings
from schemas.work import Recording
from workers.ingest.ros_definitions import ROS2_DEFINITIONS

BEGIN_NS = 1_700_000_000 * NS_PER_S
LIDAR = "/lidar/points"
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"


@dataclass(frozen=True)
class Said:
    """One message to be written: on which topic, when, and its bytes."""

    topic: str
    log_time_ns: int
    data: bytes


@dataclass(frozen=True)
class Recorder:
    """How a log is written."""

    chunk_bytes: int = 40_000
    chunked: bool = True
    compression: CompressionType = CompressionType.ZSTD
    indexes: IndexType = IndexType.ALL
    repeat_channels: bool = True
    repeat_schemas: bool = True
    statistics: bool = True
    summary_offsets: bool = True
    metadata: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    message_encoding: str = "cdr"
    schema_name: str = CLOUD_TYPE
    schema_encoding: str = "ros2msg"

    def write(self, messages: Iterable[Said]) -> bytes:
        """Write a log and return its bytes."""
        out = BytesIO()
        self._write(out, messages, lambda: None)
        return out.getvalue()

    def write_sparse(self, path: Path, messages: Iterable[Said], *, hole_bytes: int) -> None:
        """Write a log with a hole after each chunk: a record of a private type, all zeros."""
        with path.open("wb") as out:
            end = 0

            def hole() -> None:
                nonlocal end
                if out.tell() != end:  # a chunk was written
                    out.write(struct.pack("<BQ", 0x80, hole_bytes))
                    end = out.seek(hole_bytes, 1)

            self._write(out, messages, hole)

    def _write(
        self, out: BinaryIO, messages: Iterable[Said], after_each: Callable[[], None]
    ) -> None:
        writer = Writer(
            out,
            chunk_size=self.chunk_bytes,
            compression=self.compression,
            index_types=self.indexes,
            repeat_channels=self.repeat_channels,
            repeat_schemas=self.repeat_schemas,
            use_chunking=self.chunked,
            use_statistics=self.statistics,
            use_summary_offsets=self.summary_offsets,
        )
        writer.start(profile="ros2", library="test")
        schema_id = writer.register_schema(
            self.schema_name,
            self.schema_encoding,
            ROS2_DEFINITIONS["sensor_msgs/PointCloud2"].encode(),
        )
        channels: dict[str, int] = {}
        for name, values in self.metadata.items():
            writer.add_metadata(name, dict(values))
        for said in messages:
            if said.topic not in channels:
                channels[said.topic] = writer.register_channel(
                    topic=said.topic, message_encoding=self.message_encoding, schema_id=schema_id
                )
            writer.add_message(
                channels[said.topic], said.log_time_ns, said.data, publish_time=said.log_time_ns
            )
            after_each()
        writer.finish()  # type: ignore[no-untyped-call]


def ring(stamp_ns: int, *, points: int = 864, space: str = "lidar") -> bytes:
    """Write a cloud that looks like a spinning lidar's: all around, over 30 degrees."""
    rows = np.zeros((points, 4), dtype="<f4")
    azimuth_rad = np.linspace(-np.pi, np.pi, points, endpoint=False)
    elevation_rad = np.deg2rad(np.resize(np.linspace(-25.0, 5.0, 12), points))
    rows[:, 0] = 10 * np.cos(azimuth_rad) * np.cos(elevation_rad)
    rows[:, 1] = 10 * np.sin(azimuth_rad) * np.cos(elevation_rad)
    rows[:, 2] = 10 * np.sin(elevation_rad)
    return cloud(stamp_ns, rows.tobytes(), ("x", "y", "z", "intensity"), space=space)


def cloud(stamp_ns: int, rows: bytes, fields: Sequence[str], *, space: str = "lidar") -> bytes:
    """Write a sensor_msgs/PointCloud2 of float32 fields in CDR, little endian."""
    step = 4 * len(fields)
    out = bytearray(struct.pack("<iI", stamp_ns // NS_PER_S, stamp_ns % NS_PER_S))
    _string(out, space)
    _align(out)
    out += struct.pack("<III", 1, len(rows) // step, len(fields))
    for number, name in enumerate(fields):
        _align(out)
        _string(out, name)
        _align(out)
        out += struct.pack("<IB", 4 * number, 7)
        _align(out)
        out += struct.pack("<I", 1)
    out += b"\x00"
    _align(out)
    out += struct.pack("<III", step, len(rows), len(rows)) + rows + b"\x01"
    return b"\x00\x01\x00\x00" + bytes(out)


def drive(
    seconds: float,
    *,
    begin_ns: int = BEGIN_NS,
    step_s: float = 0.1,
    delay_ns: int = 0,
    topic: str = LIDAR,
    silent: Sequence[tuple[float, float]] = (),
) -> list[Said]:
    """Messages of one lidar, recorded a delay after their stamps, but for silent stretches."""
    offsets_s = [round(number * step_s, 6) for number in range(round(seconds / step_s))]
    return [
        Said(topic, begin_ns + at_ns + delay_ns, ring(begin_ns + at_ns))
        for at_s in offsets_s
        if not any(start <= at_s < end for start, end in silent)
        for at_ns in [round(at_s * NS_PER_S)]
    ]


def settings(
    *, scene_s: float = 2.0, shard_s: float = 20.0, supervised: str = ""
) -> MiningSettings:
    """Settings of a miner that has nothing but a grid."""
    return MiningSettings(
        bucket="memory://",
        artifacts="memory://",
        grid=Grid(scene_s=scene_s, shard_s=shard_s),
        supervised=supervised or "salsanext-lmnet",
    )


def only_recording(bucket: Bucket) -> Recording:
    """Return the one recording of a bucket."""
    (recording,) = group_recordings(bucket.list())
    return recording


def _string(out: bytearray, text: str) -> None:
    out += struct.pack("<I", len(text) + 1) + text.encode() + b"\x00"


def _align(out: bytearray) -> None:
    out += bytes(-len(out) % 4)
