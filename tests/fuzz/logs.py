"""Mines thousands of mutated logs: `python -m tests.fuzz.logs --runs 3000 --seed 1`.

A log must be mined, or refused in one sentence. An error that is none of ours, a process that dies,
hangs or grows beyond its limit is a failure. Each log is made of its number: `--only 17` mines that
one again, and `--write FILE` keeps it.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

from tests.fuzz.cases import case
from tests.fuzz.pool import Run, run_all

ENDS: Final = ("mined", "no scenes", "refused", "failed", "died", "hangs", "too large")
SHOWN: Final = 5
TRACE_LINES: Final = 14


def main() -> int:
    """Mine, and say how it went; 1 if the program failed with a log."""
    asked = argparse.ArgumentParser(prog="python -m tests.fuzz.logs")
    asked.add_argument("--runs", type=int, default=3000, help="how many logs")
    asked.add_argument("--seed", type=int, default=1, help="makes up the logs")
    asked.add_argument("--workers", type=int, default=2, help="processes that mine")
    asked.add_argument("--only", type=int, help="the log of this number alone")
    asked.add_argument("--write", type=Path, help="with --only: keep the log in this file")
    how = asked.parse_args()
    if how.only is not None and how.write is not None:
        how.write.write_bytes(case(how.seed, how.only)[2].write())
    numbers = range(how.runs) if how.only is None else [how.only]
    workers = min(how.workers, len(numbers))
    runs = run_all(numbers, seed=how.seed, workers=workers, on_run=_tell_failure)
    for line in summary(runs):
        sys.stdout.write(line + "\n")
    return int(any(run.failed for run in runs))


def summary(runs: Sequence[Run]) -> Iterator[str]:
    """Tell a person how many logs went."""
    yield from _table("encoding", runs, lambda run: run.encoding)
    yield from _table("first mutation", runs, lambda run: run.mutations[0])
    yield "slowest"
    for run in sorted(runs, key=lambda run: -run.seconds)[:SHOWN]:
        yield f"  {run.seconds:6.2f} s   {_named(run)}"
    yield "largest"
    for run in sorted(runs, key=lambda run: -run.peak_mb)[:SHOWN]:
        yield f"  {run.peak_mb:5d} MB   {_named(run)}"
    yield from failures(runs)


def failures(runs: Sequence[Run]) -> Iterator[str]:
    """Tell a person where the program failed, by place."""
    places: dict[tuple[str, str], list[Run]] = {}
    for run in runs:
        if run.failed:
            places.setdefault((run.end, run.problem), []).append(run)
    count = sum(map(len, places.values()))
    yield f"failures: {count} of {len(runs)} logs, in {len(places)} places"
    for (end, problem), found in sorted(places.items(), key=lambda item: -len(item[1])):
        yield f"  {len(found):4d}  {end}: {problem}"
        yield f"        first: {_named(found[0])}; in all {[run.number for run in found[:12]]}"
        yield from (f"        {line}" for line in found[0].trace.splitlines()[-TRACE_LINES:])


def _table(title: str, runs: Sequence[Run], group: Callable[[Run], str]) -> Iterator[str]:
    counts: dict[str, Counter[str]] = {}
    for run in runs:
        counts.setdefault(group(run), Counter())[run.end] += 1
    yield f"{title:20s}" + "".join(f"{end:>11s}" for end in ENDS)
    for name in sorted(counts):
        yield f"{name:20s}" + "".join(f"{counts[name][end]:11d}" for end in ENDS)
    total = Counter(run.end for run in runs)
    yield f"{'all':20s}" + "".join(f"{total[end]:11d}" for end in ENDS)


def _tell_failure(run: Run) -> None:
    """Name a failure at once on stderr; and now and then how far it is."""
    if run.failed:
        sys.stderr.write(f"{_named(run)}: {run.problem[-300:]}\n")
    elif run.number % 100 == 0:
        sys.stderr.write(f"log {run.number}\n")
    sys.stderr.flush()


def _named(run: Run) -> str:
    return f"log {run.number}, {run.encoding}: {', '.join(run.mutations)} ({run.end})"


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
