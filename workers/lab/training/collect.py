"""Files of frames to learn from, of all logs and streets of a run, and what is held out of them."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol, TypeVar

from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket, open_bucket
from workers.lab.datasets.learnt_clouds import Stretch, stretches_of
from workers.lab.training.data import HELD_OUT, MOST_HELD_OUT, DataPlan, DataSettings

Item = TypeVar("Item")

OnProgress = Callable[[str, int, int], None]
"""Called with what is done, the number done, and the number in all."""


class Maker(Protocol):
    """Makes the files that one network learns from."""

    def of_stretch(
        self,
        folder: Path,
        bucket: Bucket,
        stretch: Stretch,
        mining: MiningSettings,
        on_frame: Callable[[], None],
    ) -> list[Path]:
        """Write the files of a stretch of a log, or list those of an earlier run."""
        ...

    def of_streets(
        self, folder: Path, data: DataSettings, on_window: Callable[[], None]
    ) -> list[Path]:
        """Write the files of simulated streets, or list those of an earlier run."""
        ...


def collect(
    plan: DataPlan,
    work: Path,
    maker: Maker,
    *,
    what: str,
    every: int = 1,
    on_progress: OnProgress = lambda what, done, total: None,
) -> tuple[dict[str, list[list[Path]]], list[Path]]:
    """Make the files of all logs and streets of a run.

    Args:
        plan: Data of the run.
        work: Its work folder.
        maker: Makes the files.
        what: Name of this work for `on_progress`.
        every: One frame of so many is taken.
        on_progress: Called with each frame.

    Returns:
        Files of each stretch in order of time, by log; and those of streets.
    """
    data, done = plan.settings, [0]
    total = (data.most // every if data.bucket else 0) + 2 * data.streets

    def step() -> None:
        done[0] += 1
        on_progress(what, min(done[0], total), total)

    by_log: dict[str, list[list[Path]]] = {}
    if data.bucket:
        bucket = open_bucket(data.bucket)
        stretches = stretches_of(
            bucket, plan.recordings(bucket), plan.mining, most=data.most, frames=data.frames
        )
        for number, stretch in enumerate(stretches):
            made = maker.of_stretch(
                work / "logs" / f"{number:04d}", bucket, stretch, plan.mining, step
            )
            by_log.setdefault(stretch.recording.log_id, []).append(made)
    return by_log, maker.of_streets(work / "streets", data, step)


def split_items(
    by_log: Mapping[str, Sequence[Item]], *, most: int = MOST_HELD_OUT
) -> tuple[dict[str, list[Item]], dict[str, list[Item]]]:
    """Hold out one log of `HELD_OUT`; of a single log, its last share.

    Args:
        by_log: Items in order of time, by log.
        most: Items held out at most, evenly chosen.

    Returns:
        Items to learn from, and items that only judge.
    """
    logs = {name: list(items) for name, items in by_log.items() if items}
    if len(logs) == 1:
        ((name, items),) = logs.items()
        cut = len(items) - len(items) // HELD_OUT
        return {name: items[:cut]}, _thinned({name: items[cut:]}, most)
    last = len(logs) - 1
    chosen = {
        name
        for number, name in enumerate(logs)
        if number % HELD_OUT == HELD_OUT - 1 or (len(logs) < HELD_OUT and number == last)
    }
    learnt = {name: items for name, items in logs.items() if name not in chosen}
    return learnt, _thinned({name: logs[name] for name in logs if name in chosen}, most)


def _thinned(judged: Mapping[str, list[Item]], most: int) -> dict[str, list[Item]]:
    step = max(-(-sum(map(len, judged.values())) // most), 1)
    return {name: items[::step] for name, items in judged.items() if items}
