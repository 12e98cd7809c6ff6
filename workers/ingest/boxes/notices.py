"""Notices on a model's answers: what is wrong with them, counted, one sentence per cause."""

from collections import Counter
from collections.abc import Iterator
from typing import Final

from schemas.arrays import NS_PER_S
from workers.ingest.boxes.stated import MAX_SIZE_M, StatedBoxes
from workers.ingest.messages import MAX_TIME_NS

MAX_NAMED: Final = 5
"""Classes and frames that a sentence names."""


class BoxNotices:
    """Counts of what is wrong, over one shard.

    Args:
        topic: Where the answers are, for the sentences.
        start_ns: First instant of the shard; neighbouring shards report what is before.
        end_ns: First instant after the shard.
    """

    def __init__(self, topic: str, *, start_ns: int = 0, end_ns: int = MAX_TIME_NS) -> None:
        self._topic = topic
        self._start_ns = start_ns
        self._end_ns = end_ns
        self._without_answer: list[int] = []
        self._without_cloud: list[int] = []
        self._not_placed: Counter[tuple[str, str, bool]] = Counter()
        self._unmapped: Counter[str] = Counter()
        self._not_finite = self._impossible = 0
        self._repeated: list[str] = []

    def without_answer(self, stamp_ns: int) -> None:
        """Count a cloud without an answer."""
        if self._start_ns <= stamp_ns < self._end_ns:
            self._without_answer.append(stamp_ns)

    def without_cloud(self, stamp_ns: int) -> None:
        """Count an answer without a cloud."""
        if self._start_ns <= stamp_ns < self._end_ns:
            self._without_cloud.append(stamp_ns)

    def not_placed(self, source: str, to: str, *, known: bool) -> None:
        """Count an answer in a space that nothing joins to the lidar's."""
        self._not_placed[source, to, known] += 1

    def unmapped(self, name: str) -> None:
        """Count a box of a class that no mapping knows."""
        self._unmapped[name] += 1

    def boxes_read(self, boxes: StatedBoxes) -> None:
        """Count what was left out of an answer."""
        self._not_finite += boxes.not_finite
        self._impossible += boxes.impossible_size
        if boxes.repeated_id:
            self._repeated.append(boxes.repeated_id)

    def sentences(self) -> Iterator[str]:
        """Yield a sentence for each cause that was counted."""
        where = f"({self._topic})"
        for (source, to, known), count in sorted(self._not_placed.items()):
            why = (
                "no transform joins it to the lidar's frame then"
                if known
                else "no transform of the log names it"
            )
            yield (
                f"{count} answers in boxes are in the frame {source!r}, and {why} ({to!r}): record "
                f"/tf, /tf_static or nav_msgs/Odometry that joins both, or state boxes in {to!r}; "
                f"these frames count as without prediction {where}"
            )
        if self._without_answer:
            yield (
                f"{len(self._without_answer)} clouds have no answer of the model within half a "
                f"frame, the first at {self._without_answer[0] / NS_PER_S:.3f} s: they count as "
                f"without prediction; check that both have the stamps of one clock {where}"
            )
        if self._without_cloud:
            yield (
                f"{len(self._without_cloud)} answers match no cloud, the first at "
                f"{self._without_cloud[0] / NS_PER_S:.3f} s: they are not used; check that both "
                f"have the stamps of one clock {where}"
            )
        if self._unmapped:
            names = ", ".join(repr(name) for name, _ in self._unmapped.most_common(MAX_NAMED))
            more = len(self._unmapped) - MAX_NAMED
            yield (
                f"no mapping knows {len(self._unmapped)} classes of boxes: {names}"
                f"{f' and {more} more' if more > 0 else ''}; they count as movable: map them in "
                f"the metadata counterpoint.classes, or in classes.json next to the files {where}"
            )
        if self._not_finite:
            yield (
                f"{self._not_finite} boxes have numbers that are not finite or places beyond any "
                f"map: they are left out; repair the model's output {where}"
            )
        if self._impossible:
            yield (
                f"{self._impossible} boxes have a side of zero or over {MAX_SIZE_M:.0f} m: they "
                f"are left out; repair the model's output {where}"
            )
        if self._repeated:
            yield (
                f"{len(self._repeated)} answers give one identity to several boxes, the first "
                f"{self._repeated[0]!r}: these boxes count as without track, so that only a stated "
                f"velocity says that they move; number the objects of a frame {where}"
            )
