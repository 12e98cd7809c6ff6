"""Clouds of the further lidars of a simulated car, each on a topic and in a space of its own."""

from collections.abc import Sequence
from typing import Final

from mcap.records import Schema
from mcap_ros2.writer import Writer

from schemas.arrays import NS_PER_S
from workers.lab.simulation.faults.faults import PlantedFailure
from workers.lab.simulation.faults.recorded import noise_of, record
from workers.lab.simulation.output.cloud import cloud_of, message_of
from workers.lab.simulation.output.static_spaces import (
    TF_DEFINITION,
    TF_MESSAGE,
    TF_STATIC_TOPIC,
    static_message,
)
from workers.lab.simulation.sensor.lidar import Lidar, mounting, sweep
from workers.lab.simulation.sensor.sensors import NEAR_FIELD_PLACES
from workers.lab.simulation.world.street import Street

FURTHER_TOPIC: Final = "/lidar/{place}/points"
FURTHER_SPACE: Final = "lidar_{place}"


class FurtherWriter:
    """Writes the clouds of further lidars, and once where all lidars of the car are mounted.

    Args:
        writer: Writer of the log.
        street: Street with the drive of the ego.
        lidars: The further lidars; without any nothing is written.
        lifelike: Whether the labels have the noise of real models.
        start_ns: Time of the beginning, nanoseconds since the Unix epoch.
    """

    def __init__(
        self,
        writer: Writer,
        street: Street,
        lidars: Sequence[Lidar],
        *,
        lifelike: bool,
        start_ns: int,
    ) -> None:
        self._writer, self._street, self._start_ns = writer, street, start_ns
        self._lidars = list(zip(NEAR_FIELD_PLACES, lidars, strict=False))
        self._noise = [noise_of(street) if lifelike else None for _ in lidars]

    def place(self, space: str, lidar: Lidar) -> None:
        """Write where the main lidar, of this space, and the further ones are mounted."""
        if not self._lidars:
            return
        placed = {space: mounting(lidar)}
        placed |= {FURTHER_SPACE.format(place=name): mounting(each) for name, each in self._lidars}
        schema = self._writer.register_msgdef(TF_MESSAGE, TF_DEFINITION)
        message = static_message(placed, stamp_ns=self._start_ns)
        self._writer.write_message(TF_STATIC_TOPIC, schema, message, self._start_ns, self._start_ns)

    def write(self, index: int, schema: Schema, failures: Sequence[PlantedFailure] | None) -> None:
        """Write one cloud of each lidar.

        Args:
            index: Number of the frame of the main lidar.
            schema: Of the clouds.
            failures: Failures of the model that labels their points; None: it labels none.
        """
        for (name, lidar), noise in zip(self._lidars, self._noise, strict=True):
            frame = sweep(self._street, lidar, index)
            labels = (
                None if failures is None else record(self._street, frame, failures, noise=noise)
            )
            stamp_ns = self._start_ns + round(frame.time_s * NS_PER_S)
            rows = cloud_of(frame, labels)
            message = message_of(rows, stamp_ns=stamp_ns, space=FURTHER_SPACE.format(place=name))
            topic = FURTHER_TOPIC.format(place=name)
            self._writer.write_message(topic, schema, message, stamp_ns, stamp_ns, index)
