"""Messages of the simulated car's detector: one JSON message of boxes per frame."""

import json
from collections.abc import Sequence
from typing import Any, Final

from mcap_ros2.writer import Writer

from schemas.predicted_boxes import SCHEMA_NAME, PredictedBoxes
from workers.lab.simulation.faults.detected_boxes import DetectedBox
from workers.lab.simulation.faults.detector import Detector
from workers.lab.simulation.faults.faults import PlantedFailure
from workers.lab.simulation.faults.street_bodies import street_bodies
from workers.lab.simulation.sensor.lidar import SimulatedFrame
from workers.lab.simulation.world.street import Street

BOXES_TOPIC: Final = "/perception/objects"


class DetectorWriter:
    """Runs the detector of a drive, and writes its boxes next to the clouds of a log."""

    def __init__(self, writer: Writer, street: Street) -> None:
        self._street = street
        self._detector = Detector(street.seed, len(street.actors))
        self._mcap = writer._writer
        published = json.dumps(PredictedBoxes.model_json_schema()).encode()
        schema = self._mcap.register_schema(name=SCHEMA_NAME, encoding="jsonschema", data=published)
        self._channel = self._mcap.register_channel(
            topic=BOXES_TOPIC, message_encoding="json", schema_id=schema
        )

    def write(
        self,
        frame: SimulatedFrame,
        failures: Sequence[PlantedFailure],
        *,
        stamp_ns: int,
        space: str,
    ) -> None:
        """Detect the objects of the next frame and write one message."""
        bodies = street_bodies(self._street, frame.time_s)
        boxes = self._detector.detect(frame, bodies, failures)
        message = message_of_boxes(boxes, stamp_ns=stamp_ns, space=space)
        self._mcap.add_message(
            channel_id=self._channel,
            log_time=stamp_ns,
            publish_time=stamp_ns,
            sequence=frame.index,
            data=json.dumps(message, separators=(",", ":")).encode(),
        )


def message_of_boxes(boxes: Sequence[DetectedBox], *, stamp_ns: int, space: str) -> dict[str, Any]:
    """Return the fields of a message of boxes (`schemas.predicted_boxes.PredictedBoxes`)."""
    return {
        "stamp_ns": stamp_ns,
        "frame_id": space,
        "boxes": [
            {
                "centre_m": each.centre_m,
                "size_m": each.size_m,
                "yaw_rad": each.yaw_rad,
                "velocity_m_per_s": (*each.velocity_m_per_s, 0.0),
                "class_name": each.class_name,
                "score": each.score,
                "track_id": str(each.track_id),
            }
            for each in boxes
        ],
    }
