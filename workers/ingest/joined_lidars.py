"""Further lidars of the car in planning: their place, clock, labels and chunks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from schemas.arrays import NS_PER_S, Transform
from schemas.mining import MiningSettings
from schemas.work import Damage, FurtherLidar
from workers.errors import LogUnusableError
from workers.ingest.frames import intensity_scale_of
from workers.ingest.log_index import LogIndex
from workers.ingest.message_lookup import MessageLookup, readable
from workers.ingest.recorded_source import labels_of_further
from workers.ingest.shard_windows import Span
from workers.ingest.topic_sampling import Sample
from workers.ingest.topic_spans import spans_of
from workers.ingest.topics import Topic, without_schema
from workers.ingest.transforms import TransformTree, has_transforms, is_static, stated_transforms
from workers.points.se3 import inverse

USUAL_PERIOD_NS: Final = NS_PER_S // 10
"""Step between frames where a single one was sampled: that of most lidars."""

MAX_CLOCKS_APART_NS: Final = NS_PER_S // 2
"""Difference of the usual delays of two lidars from which their clocks differ, nanoseconds.

Transport and drivers of one car take some tens of milliseconds more or less; clocks that are not
synchronised are seconds apart, or 37 s where one of them is on atomic time."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundLidar:
    """A further lidar, and the chunks that it needs."""

    lidar: FurtherLidar
    spans: list[Span]


def find_further(
    index: LogIndex,
    topics: Sequence[Topic],
    samples: Mapping[str, Sample],
    settings: MiningSettings,
    damage: list[Damage],
) -> list[FoundLidar]:
    """Find what joins the further lidars of the setting `lidar_topic` to the first one.

    Args:
        index: Of the log.
        topics: All of the log.
        samples: Of all named topics, and of those that may hold labels.
        settings: The named topics, and whether labels are read.
        damage: Chunks that cannot be read are added here.

    Raises:
        LogUnusableError: If the log does not place one of them, or their clocks differ.
    """
    first, *others = settings.lidar_names
    if not others:
        return []
    main = samples[first]
    placing = [topic for topic in topics if has_transforms(topic.channel)]
    lookup = MessageLookup(
        index, placing, log_time_ns=main.log_times_ns[0], reach_ns=USUAL_PERIOD_NS
    )
    tree = TransformTree()
    for topic in placing:
        if is_static(topic.channel):
            for stated in readable(lookup.all(topic), stated_transforms):
                tree.add_stated(stated)
    found = []
    for name in others:
        sample = samples[name]
        _need_one_clock(main, sample)
        source, labels = None, list[Span]()
        if settings.takes_recorded and not settings.predictions:
            source, labels = labels_of_further(index, topics, sample, samples, damage)
        lidar = FurtherLidar(
            channel=without_schema(sample.topic.channel),
            recorded=source,
            main_from_lidar=tuple(_placed(tree, main, sample).ravel().tolist()),
            period_ns=period_ns(main),
            intensity_scale=settings.intensity_scale
            or intensity_scale_of([*sample.clouds, *sample.later_clouds]),
        )
        half_ns = lidar.period_ns // 2
        spans = [
            replace(
                span, earliest_ns=span.earliest_ns - half_ns, latest_ns=span.latest_ns + half_ns
            )
            for span in (*spans_of(index, sample, damage), *labels)
        ]
        found.append(FoundLidar(lidar, spans))
    return found


def period_ns(sample: Sample) -> int:
    """Return the usual step between the frames of a lidar, nanoseconds."""
    steps_ns = np.diff(sample.stamps_ns)
    rising_ns = np.sort(steps_ns[steps_ns > 0])
    return int(rising_ns[len(rising_ns) // 2]) if len(rising_ns) else USUAL_PERIOD_NS


def _placed(tree: TransformTree, main: Sample, sample: Sample) -> Transform:
    """Return the (4, 4) transform of a lidar's points to those of the main one."""
    to, source = main.clouds[0], sample.clouds[0]
    placed = tree.find(to=to.frame_id, source=source.frame_id)
    if placed is None:
        raise LogUnusableError(
            f"no transform from {source.frame_id!r} to {to.frame_id!r} on a topic tf_static: "
            f"{sample.topic.channel.topic} cannot be joined to {main.topic.channel.topic}; record "
            "the transforms, or name one lidar in lidar_topic"
        )
    if source.space_from_points is not None:
        placed = placed @ source.space_from_points
    if to.space_from_points is not None:
        placed = inverse(to.space_from_points) @ placed
    return placed


def _need_one_clock(main: Sample, sample: Sample) -> None:
    names = f"{main.topic.channel.topic} and {sample.topic.channel.topic}"
    apart_ns = abs(main.usual_delay_ns - sample.usual_delay_ns)
    if apart_ns > MAX_CLOCKS_APART_NS:
        raise LogUnusableError(
            f"the clocks of {names} are {apart_ns / NS_PER_S:.1f} s apart by their log times: "
            "their clouds cannot be joined; name one lidar in lidar_topic"
        )
    for each in (main, sample):
        if each.by_log_time:
            raise LogUnusableError(
                f"the clock of {each.topic.channel.topic} jumps within the log: {names} cannot be "
                "joined; name one lidar in lidar_topic"
            )
