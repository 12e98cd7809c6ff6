"""MCAP writer of a simulated street, in the format of a recorder on a car, with its truth."""

import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final, Literal

from mcap_ros2.writer import Writer

from workers.lab.simulation.faults.disturbances import delay_ns, disturb
from workers.lab.simulation.faults.fault_truth import NOTHING_PLANTED, PlantedFaults
from workers.lab.simulation.faults.recorded import noise_of, record, recorded_classes
from workers.lab.simulation.output.box_messages import DetectorWriter
from workers.lab.simulation.output.cloud import (
    POINT_CLOUD2,
    POINT_CLOUD2_DEFINITION,
    cloud_of,
    labels_of,
    message_of,
)
from workers.lab.simulation.output.fixes import FixWriter
from workers.lab.simulation.output.further_lidars import FurtherWriter
from workers.lab.simulation.output.odometry import OdometryWriter
from workers.lab.simulation.output.truth import TruthWriter
from workers.lab.simulation.sensor.compensation import compensate
from workers.lab.simulation.sensor.lidar import Lidar, sweep
from workers.lab.simulation.world.street import Street

LIDAR_TOPIC: Final = "/lidar/top/points"
LABEL_TOPIC: Final = "/lidar/top/labels"

LIDAR_SPACE: Final = "lidar_top"

RecordedAs = Literal["fields", "topic", "boxes", "nothing"]
"""Form of the on-board model's answer: fields of the cloud, own topic, a detector's boxes, none."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity of a log (MCAP metadata record `counterpoint.log`)."""

    vehicle: str = "sim-01"
    date: str = "2026-03-02"
    software_version: str = "2026.1"
    start_ns: int = 1_772_445_600_000_000_000


def write_log(
    output: Path | IO[bytes],
    street: Street,
    *,
    lidar: Lidar | None = None,
    further: Sequence[Lidar] = (),
    identity: Identity | None = None,
    recorded: RecordedAs = "fields",
    odometry: bool = False,
    fixes: bool = False,
    planted: PlantedFaults = NOTHING_PLANTED,
    truth: Path | None = None,
    log_key: str = "",
    chunk_bytes: int = 4 << 20,
    frames: int | None = None,
    progress: Callable[[], None] | None = None,
) -> int:
    """Simulate the drive through a street, and write the lidar's frames as a log.

    Args:
        output: File to write (it is replaced atomically), or a stream.
        street: The street with its traffic.
        lidar: The lidar on the car; 64 beams and 1024 columns at 10 Hz when None.
        further: Near-field lidars, each with its own space, topic and labels in its clouds.
        identity: Vehicle, date, software version and time of the first frame.
        recorded: Form of the on-board model's answer.
        odometry: Whether the car records wheel speed and yaw rate.
        fixes: Whether it records its place on Earth.
        planted: Failures of that model, and disturbances of the sensor.
        truth: Folder for the truth of this log; None writes none.
        log_key: Key of the log in the truth.
        chunk_bytes: Uncompressed size at which a chunk is closed; zstd, with CRC and summary.
        frames: Number of frames; all of the street's duration when None.
        progress: Called after each frame.

    Returns:
        Number of frames written.
    """
    lidar, identity = lidar or Lidar(), identity or Identity()
    count = int(street.seconds / lidar.period_s + 1e-9) if frames is None else frames
    truth_writer = TruthWriter(truth, street, lidar, log_key, LIDAR_TOPIC) if truth else None
    with growing_file(output) as stream:
        writer = Writer(stream, chunk_size=chunk_bytes)
        schema = writer.register_msgdef(POINT_CLOUD2, POINT_CLOUD2_DEFINITION)
        writer.add_metadata(
            "counterpoint.log",
            {
                "vehicle": identity.vehicle,
                "date": identity.date,
                "software_version": identity.software_version,
            },
        )
        if recorded != "nothing":
            writer.add_metadata("counterpoint.classes", recorded_classes())
        moved = OdometryWriter(writer, street, start_ns=identity.start_ns) if odometry else None
        drive = f"{identity.vehicle} {identity.date}"
        placed = (
            FixWriter(writer, street, start_ns=identity.start_ns, drive=drive) if fixes else None
        )
        noise = noise_of(street) if planted.lifelike else None
        others = FurtherWriter(
            *(writer, street, further), lifelike=planted.lifelike, start_ns=identity.start_ns
        )
        others.place(LIDAR_SPACE, lidar)
        detector = DetectorWriter(writer, street) if recorded == "boxes" else None
        for index in range(count):
            frame = disturb(sweep(street, lidar, index), planted.disturbances)
            late_ns = delay_ns(index, frame.time_s, planted.disturbances)
            if lidar.compensated:
                frame = compensate(street, lidar, frame)
                late_ns += lidar.period_ns // 2
            onboard = None
            if recorded in ("fields", "topic"):
                onboard = record(street, frame, planted.failures, noise=noise)
            stamp_ns = identity.start_ns + index * lidar.period_ns + late_ns
            for each in (moved, placed):
                if each is not None:
                    each.write_until(stamp_ns)
            labels_in_cloud = onboard if recorded == "fields" else None
            rows = cloud_of(frame, labels_in_cloud, firing=not lidar.compensated)
            message = message_of(rows, stamp_ns=stamp_ns, space=LIDAR_SPACE)
            writer.write_message(LIDAR_TOPIC, schema, message, stamp_ns, stamp_ns, index)
            others.write(index, schema, planted.failures if recorded == "fields" else None)
            if recorded == "topic" and onboard is not None:
                labels = message_of(labels_of(onboard), stamp_ns=stamp_ns, space=LIDAR_SPACE)
                writer.write_message(LABEL_TOPIC, schema, labels, stamp_ns, stamp_ns, index)
            if detector is not None:
                detector.write(frame, planted.failures, stamp_ns=stamp_ns, space=LIDAR_SPACE)
            if truth_writer is not None:
                truth_writer.add(frame, stamp_ns=stamp_ns, data_crc32=zlib.crc32(message["data"]))
            if progress is not None:
                progress()
        for each in (moved, placed):
            if each is not None:
                each.write_until(identity.start_ns + count * lidar.period_ns)
        writer.finish()  # type: ignore[no-untyped-call]  # upstream lacks the return type
    if truth_writer is not None:
        truth_writer.finish(planted.truth(identity.start_ns))
    return count


@contextmanager
def growing_file(output: Path | IO[bytes]) -> Iterator[IO[bytes]]:
    """Write a file under a temporary name, then rename it: watchers see it whole or not at all."""
    if not isinstance(output, Path):
        yield output
        return
    output.parent.mkdir(parents=True, exist_ok=True)
    growing = output.with_name(output.name + ".part")
    with growing.open("wb") as stream:
        yield stream
    growing.replace(output)
