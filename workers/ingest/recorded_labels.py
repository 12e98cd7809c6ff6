"""Recorded labels of the model on the car: their source, classes and pairing with clouds."""

import json
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from schemas.bounds import MAX_NAME
from schemas.canonical import canonical_json
from schemas.frame import RecordedClass, RecordedLabels
from schemas.visible import visible
from schemas.work import Channel, RecordedSource
from workers.errors import CloudUnreadableError, LogUnusableError
from workers.ingest.limits import MAX_SCHEMA_TEXT, MAX_WAITING_POINTS
from workers.ingest.pointcloud import LABEL_FIELD, DecodedCloud, is_cloud

CLASSES_RECORD: Final = "counterpoint.classes"
"""Name of the MCAP metadata record: class id to a JSON object {name, movable, moving}."""

MOTION_FIELD: Final = "motion"
CONFIDENCE_FIELD: Final = "confidence"

MAX_WAITING: Final = 10
"""Clouds held back for their labels: a second at 10 Hz, longer than a model on a car may take."""

Item = TypeVar("Item")


def find_recorded_source(
    channels: Sequence[Channel],
    metadata: Mapping[str, Mapping[str, str]],
    *,
    lidar: Channel,
    clouds: Mapping[str, Sequence[DecodedCloud]],
) -> RecordedSource | None:
    """Find the recorded labels of a lidar, if the log has any.

    Labels are fields of the lidar's own clouds, or of a topic whose clouds have the stamps and
    widths of the lidar's. Without classes in the metadata they count only if they state motion.

    Args:
        channels: All of the log.
        metadata: MCAP metadata records by name; of a split recording, of all its parts.
        lidar: The lidar whose labels are wanted.
        clouds: Some decoded clouds of the log by topic, of the same stretch of time.

    Raises:
        LogUnusableError: If the classes in the metadata are invalid.
    """
    record = metadata.get(CLASSES_RECORD)
    classes_json = canonical_json(dict(record or {})).decode()
    if len(classes_json) > MAX_SCHEMA_TEXT:
        raise LogUnusableError(
            f"the classes of metadata {CLASSES_RECORD} take {len(classes_json)} characters, more "
            f"than {MAX_SCHEMA_TEXT}"
        )
    recorded_classes(classes_json)
    found = find_labels(channels, has_classes=record is not None, lidar=lidar, clouds=clouds)
    if found is None:
        return None
    channel = None if found.topic == lidar.topic else found
    return RecordedSource(channel=channel, classes_json=classes_json)


def find_labels(
    channels: Sequence[Channel],
    *,
    has_classes: bool,
    lidar: Channel,
    clouds: Mapping[str, Sequence[DecodedCloud]],
) -> Channel | None:
    """Find the channel of a lidar's recorded labels, which may be its own.

    Args:
        channels: All of the log.
        has_classes: The log defines its class ids.
        lidar: The lidar whose labels are wanted.
        clouds: As for `find_recorded_source`.
    """
    own = clouds.get(lidar.topic, ())
    if any(_states_motion(cloud, has_classes=has_classes) for cloud in own):
        return lidar
    widths = {cloud.stamp_ns: len(cloud) for cloud in own}
    for channel in sorted(channels, key=lambda channel: channel.topic):
        if channel.topic == lidar.topic or not is_cloud(channel):
            continue
        if any(
            _states_motion(cloud, has_classes=has_classes)
            and widths.get(cloud.stamp_ns) == len(cloud)
            for cloud in clouds.get(channel.topic, ())
        ):
            return channel
    return None


_WHERE: Final = f"the metadata {CLASSES_RECORD}, or classes.json next to the files"


@lru_cache(maxsize=8)
def recorded_classes(classes_json: str) -> Mapping[int, RecordedClass]:
    """Read the classes of the model's class ids.

    Args:
        classes_json: A JSON object of class id to a string that is itself JSON
            {name, movable, moving}.

    Raises:
        LogUnusableError: If it is anything else.
    """
    classes: dict[int, RecordedClass] = {}
    for key, text in sorted(json.loads(classes_json).items()):
        try:
            entry = json.loads(text)
            name, movable, moving = entry["name"], entry["movable"], entry["moving"]
            class_id = int(key)
        except (ValueError, TypeError, LookupError, RecursionError) as error:
            raise LogUnusableError(
                f"cannot read class {key!r} of {_WHERE}: {text!r} must be JSON "
                f"with name, movable and moving, its key a number ({type(error).__name__}: {error})"
            ) from error
        if not (isinstance(name, str) and isinstance(movable, bool) and isinstance(moving, bool)):
            raise LogUnusableError(
                f"cannot read class {key!r} of {_WHERE}: name must be text, "
                f"movable and moving true or false, got {text!r}"
            )
        name = visible(name, limit=MAX_NAME)
        classes[class_id] = RecordedClass(name=name, movable=movable, moving=moving)
    return classes


@np.errstate(over="ignore", invalid="ignore")  # what is no label is refused below
def recorded_labels(cloud: DecodedCloud, source: RecordedSource) -> RecordedLabels:
    """Read the labels in a cloud, exactly as recorded.

    Args:
        cloud: The lidar's own, or that of the labels' topic, whose points are the lidar's.
        source: The classes of the class ids.

    Raises:
        CloudUnreadableError: If a field is missing, or has values beyond its type.
    """
    return RecordedLabels(
        class_id=_whole(cloud, LABEL_FIELD, np.uint16),
        motion=_whole(cloud, MOTION_FIELD, np.uint8) if MOTION_FIELD in cloud.fields else None,
        confidence=_confidence(cloud) if CONFIDENCE_FIELD in cloud.fields else None,
        classes=recorded_classes(source.classes_json),
    )


class LabelPairing(Generic[Item]):
    """Pairs clouds with the labels of another topic, by equal stamp and width.

    Labels may come before their cloud or, since a model takes time, after it. Clouds leave in the
    order they came; one whose labels do not come within `MAX_WAITING` clouds leaves without. A
    cloud that was recorded twice has its labels twice.
    """

    def __init__(self, source: RecordedSource) -> None:
        """Begin with nothing waiting; `source` defines the labels."""
        self._source = source
        self._waiting: deque[tuple[tuple[int, int], Item]] = deque()
        self._labels: dict[tuple[int, int], RecordedLabels] = {}

    def add_cloud(
        self, cloud: DecodedCloud, item: Item
    ) -> Iterator[tuple[Item, RecordedLabels | None]]:
        """Add a cloud of the lidar and yield the complete ones; `item` is passed through."""
        self._waiting.append(((cloud.stamp_ns, len(cloud)), item))
        yield from self._complete()

    def add_labels(self, cloud: DecodedCloud) -> Iterator[tuple[Item, RecordedLabels | None]]:
        """Add a cloud of the labels' topic and yield the complete ones.

        Raises:
            CloudUnreadableError: If it has no labels.
        """
        self._labels[cloud.stamp_ns, len(cloud)] = recorded_labels(cloud, self._source)
        while len(self._labels) > 2 * MAX_WAITING or (
            len(self._labels) > 1 and sum(key[1] for key in self._labels) > 2 * MAX_WAITING_POINTS
        ):
            del self._labels[next(iter(self._labels))]
        yield from self._complete()

    def rest(self) -> Iterator[tuple[Item, RecordedLabels | None]]:
        """Yield the clouds that still wait, once no more messages come."""
        while self._waiting:
            key, item = self._waiting.popleft()
            yield item, self._labels.get(key)

    def _complete(self) -> Iterator[tuple[Item, RecordedLabels | None]]:
        while self._waiting:
            key, item = self._waiting[0]
            few = sum(waiting[1] for waiting, _ in self._waiting) <= MAX_WAITING_POINTS
            if key not in self._labels and few and len(self._waiting) <= MAX_WAITING:
                return
            self._waiting.popleft()
            yield item, self._labels.get(key)


def _states_motion(cloud: DecodedCloud, *, has_classes: bool) -> bool:
    return LABEL_FIELD in cloud.fields and (has_classes or MOTION_FIELD in cloud.fields)


def _whole(cloud: DecodedCloud, name: str, dtype: type[Any]) -> NDArray[Any]:
    if name not in cloud.fields:
        raise CloudUnreadableError(
            f"cannot read recorded labels: no field {name!r}; fields are "
            f"{', '.join(sorted(cloud.fields))} (stamp {cloud.stamp_ns})"
        )
    values = cloud.fields[name]
    limit = np.iinfo(dtype).max
    whole = values.astype(dtype)
    if values.ndim != 1 or not np.array_equal(whole, values):
        raise CloudUnreadableError(
            f"cannot read recorded labels: field {name!r} must hold one whole number from 0 to "
            f"{limit} per point (stamp {cloud.stamp_ns})"
        )
    return whole


def _confidence(cloud: DecodedCloud) -> NDArray[np.float32]:
    values = cloud.fields[CONFIDENCE_FIELD].astype(np.float32)
    if values.ndim != 1 or not ((values >= 0) & (values <= 1)).all():
        raise CloudUnreadableError(
            f"cannot read recorded labels: field {CONFIDENCE_FIELD!r} must hold one number from "
            f"0 to 1 per point (stamp {cloud.stamp_ns})"
        )
    return values
