"""Recorded boxes of a variant: true boxes, planted failures, and the errors of a detector."""

import json
from collections.abc import Iterator, Sequence
from typing import Final

from schemas.boxes import RecordedBoxes
from schemas.predicted_boxes import SCHEMA_NAME
from schemas.work import Channel
from workers.ingest.boxes.class_meanings import ClassMeanings
from workers.ingest.boxes.notices import BoxNotices
from workers.ingest.boxes.pairing import BoxPairing
from workers.ingest.boxes.spaces import Spaces
from workers.ingest.boxes.stated import stated_boxes
from workers.ingest.messages import RawMessage
from workers.ingest.pointcloud import DecodedCloud
from workers.lab.evaluation.failures.planting.drive import Drive
from workers.lab.evaluation.failures.planting.labels import CLASSES
from workers.lab.evaluation.failures.planting.variants import Variant
from workers.lab.simulation.faults.detected_boxes import NO_BOX
from workers.lab.simulation.faults.detector import Detector
from workers.lab.simulation.faults.faults import PlantedFailure
from workers.lab.simulation.faults.plan import FailureKind
from workers.lab.simulation.output.box_messages import BOXES_TOPIC, message_of_boxes

_NO_BOX: Final = NO_BOX | {FailureKind.MISSED_MOVER}
"""Kinds by which an object of a real drive has no box. The simulator keeps a standing box for a
missed mover, here a model regression does that."""

_CHANNEL: Final = Channel(
    topic=BOXES_TOPIC,
    message_encoding="json",
    schema_name=SCHEMA_NAME,
    schema_encoding="jsonschema",
    schema_base64="",
    ids=((0, 1),),
)


def messages_of_variant(
    drive: Drive, variant: Variant, failures: Sequence[PlantedFailure]
) -> Iterator[bytes]:
    """Yield the message of boxes of each frame, `counterpoint.boxes.v1`, as a log records it."""
    detector = Detector(variant.seed, len(drive.actors), no_box=_NO_BOX)
    for frame in drive.frames:
        boxes = detector.detect(frame, frame.bodies, failures)
        stamp_ns = frame.posed.frame.stamp_ns
        message = message_of_boxes(boxes, stamp_ns=stamp_ns, space="")
        yield json.dumps(message, separators=(",", ":")).encode()


def boxes_of_variant(
    drive: Drive, variant: Variant, failures: Sequence[PlantedFailure]
) -> Iterator[RecordedBoxes | None]:
    """Yield the boxes of each frame as ingest reads them from a log with these messages."""
    notices = BoxNotices(BOXES_TOPIC, start_ns=0, end_ns=0)
    pairing: BoxPairing[None] = BoxPairing(Spaces(), ClassMeanings(CLASSES), notices)
    messages = messages_of_variant(drive, variant, failures)
    for frame, data in zip(drive.frames, messages, strict=True):
        stamp_ns = frame.posed.frame.stamp_ns
        boxes = stated_boxes(RawMessage(_CHANNEL, stamp_ns, data))
        cloud = DecodedCloud(stamp_ns, "", len(frame.points_m), 1, {}, b"")
        yield from (found for _, found in pairing.add_boxes(boxes, stamp_ns))
        yield from (found for _, found in pairing.add_cloud(cloud, stamp_ns, None))
