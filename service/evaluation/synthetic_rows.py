"""Selection from many synthetic rows: time, memory, and one pass against the offline choice."""

import resource
import time
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.attribution import Wrong
from schemas.contradiction import ContradictionKind
from service.curation.candidates import BALANCED, Rows
from service.curation.descriptors import Tracks, class_bin, describe_scenes, describe_tracks
from service.curation.greedy import pick, value_of
from service.curation.objectives import DETERMINANTAL, K_CENTRE, ObjectiveKind
from service.curation.one_pass import OnePass

OBJECTIVES: Final = {"determinantal": DETERMINANTAL, "k-centre": K_CENTRE}
BUDGETS: Final = (50, 500)
CLASSES: Final = ("", "car", "truck", "pedestrian", "cyclist", "bus", "van", "animal")
GROUPS: Final = 20
ORDERS: Final = ("best first", "random", "best last")
STREAMED: Final = 100_000
"""Rows of the stream of one pass."""

_BYTES_PER_KIB: Final = 1024


class SpeedRow(BaseModel):
    """Time of one selection."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    strategy: str
    scores: str = Field(description="`few high`: as of a fleet; `even`: 0 to 1 evenly.")
    rows: int
    budget: int
    seconds: float = Field(description="Processor time.")
    peak_mib: float = Field(description="Memory of the process at most, MiB.")
    compared: int = Field(description="Rows that were compared; the others could not matter.")
    missed: float = Field(
        description="Bound on what one further row could add beyond the last choice; 0: none could."
    )


class StreamRow(BaseModel):
    """One pass over a stream, against the greedy choice of all its rows."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    strategy: str
    order: str
    rows: int
    budget: int
    seconds: float = Field(description="Processor time.")
    share: float = Field(description="Value of its choice over that of the greedy choice.")


class SyntheticPool:
    """Rows of made-up scenes, best first; descriptors are made of as many as are read."""

    def __init__(self, count: int, *, even: bool, seed: int = 0) -> None:
        """Make scores, one to three tracks per scene, and groups."""
        rng = np.random.default_rng(seed)
        drawn = rng.random(count) if even else rng.beta(0.6, 6.0, count)
        self.quality: NDArray[np.float64] = np.sort(drawn)[::-1].copy()
        self._scene = np.repeat(np.arange(count), rng.integers(1, 4, count))
        tracks = len(self._scene)
        classes = np.array([class_bin(name) for name in CLASSES])
        measured = rng.random(tracks) < 0.6
        self._strength = rng.random(tracks)
        self._columns = {
            "kind": rng.integers(0, len(ContradictionKind), tracks),
            "class_name": classes[rng.integers(0, len(classes), tracks)],
            "wrong": rng.integers(0, len(Wrong), tracks),
            "length_m": rng.lognormal(0.5, 0.8, tracks),
            "height_m": rng.lognormal(0.3, 0.5, tracks),
            "speed_m_per_s": rng.exponential(5.0, tracks) * measured,
            "range_m": rng.uniform(2.0, 80.0, tracks),
            "bearing_rad": rng.uniform(-np.pi, np.pi, tracks),
        }
        self._groups = rng.integers(0, GROUPS, (count, len(BALANCED)))

    def first(self, count: int) -> Rows:
        """Return the first rows, all where there are fewer."""
        count = min(count, len(self.quality))
        tracks = int(np.searchsorted(self._scene, count))
        columns = Tracks(**{name: each[:tracks] for name, each in self._columns.items()})
        found = describe_scenes(
            describe_tracks(columns), self._scene[:tracks], self._strength[:tracks], count=count
        )
        return Rows(self.quality[:count], found, self._groups[:count])

    def quality_at(self, number: int) -> float:
        """Return the score after `number` others; 0 where there is none."""
        return float(self.quality[number]) if number < len(self.quality) else 0.0


def speed_rows(count: int) -> list[SpeedRow]:
    """Time selections from `count` synthetic rows."""
    found = []
    for scores, even in (("few high", False), ("even", True)):
        pool = SyntheticPool(count, even=even)
        for name, objective in OBJECTIVES.items():
            for budget in BUDGETS:
                began_s = time.process_time()
                picked = pick(pool, objective, budget=budget)
                found.append(
                    SpeedRow(
                        strategy=name,
                        scores=scores,
                        rows=count,
                        budget=budget,
                        seconds=round(time.process_time() - began_s, 3),
                        peak_mib=_peak_mib(),
                        compared=picked.compared,
                        missed=round(picked.missed, 4),
                    )
                )
    return found


def stream_rows(count: int) -> list[StreamRow]:
    """Measure one pass over streams of at most `STREAMED` rows, in three orders."""
    found = []
    pool = SyntheticPool(min(count, STREAMED), even=False, seed=1)
    rows = pool.first(len(pool.quality))
    for name, objective in OBJECTIVES.items():
        for budget in BUDGETS:
            offline = pick(pool, objective, budget=budget, most_read=len(rows)).numbers.tolist()
            best = value_of(rows, offline, objective)
            for order in ORDERS:
                stream = _ordered(len(rows), order)
                began_s = time.process_time()
                chosen = _in_one_pass(rows, stream, objective, budget=budget)
                seconds = time.process_time() - began_s
                share = value_of(rows, chosen, objective) / best
                found.append(
                    StreamRow(
                        strategy=name,
                        order=order,
                        rows=len(rows),
                        budget=budget,
                        seconds=round(seconds, 3),
                        share=round(share, 4),
                    )
                )
    return found


def _in_one_pass(
    rows: Rows, stream: NDArray[np.int64], objective: ObjectiveKind, *, budget: int
) -> list[int]:
    one = OnePass[int](objective, budget=budget)
    one.offer(stream.tolist(), rows.at(stream))
    return [number for number, _ in one.chosen()]


def _ordered(count: int, order: str) -> NDArray[np.int64]:
    numbers = np.arange(count)
    if order == "random":
        return np.random.default_rng(2).permutation(count)
    return numbers[::-1].copy() if order == "best last" else numbers


def _peak_mib() -> float:
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _BYTES_PER_KIB, 1)
