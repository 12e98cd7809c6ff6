"""Kills, freezes and cuts parts of a real system: `python -m tests.chaos --seed 1 --seconds 60`.

It needs PostgreSQL's programs, and root for the small disk. It exits with 1 if anything differs
from a run that nothing disturbs, and with 2 if a part that was asked for cannot run here.
"""

import argparse
import logging
import sys
from typing import get_args

import structlog

from tests.chaos.parts import Parts, PoolKind
from tests.chaos.run import run_chaos


def main() -> int:
    """Run the seeds one after the other, and say what was left."""
    asked = argparse.ArgumentParser(prog="python -m tests.chaos")
    asked.add_argument("--seed", type=int, default=1, help="of the first run")
    asked.add_argument("--runs", type=int, default=1, help="runs with a seed more each")
    asked.add_argument("--seconds", type=float, default=60.0, help="longest time of the blows")
    asked.add_argument("--kills", type=int, default=None, help="kills that end a run earlier")
    asked.add_argument("--clocks", choices=("wrong", "right"), default="wrong", help="of processes")
    asked.add_argument("--bucket", choices=("folder", "s3"), default="folder", help="of the logs")
    asked.add_argument("--pool", choices=get_args(PoolKind), default=None, help="who mines")
    how = asked.parse_args()
    is_s3 = how.bucket == "s3"
    parts = Parts(how.clocks == "wrong", is_s3, how.pool or ("local" if is_s3 else "quick"))
    if absent := parts.absent():
        sys.stderr.write("cannot run: " + "; ".join(absent) + "\n")
        return 2
    quiet = structlog.make_filtering_bound_logger(logging.ERROR)
    structlog.configure(wrapper_class=quiet)
    problems, kills = 0, 0
    for seed in range(how.seed, how.seed + how.runs):
        report = run_chaos(seed=seed, seconds=how.seconds, kills=how.kills, parts=parts)
        for line in report.lines():
            sys.stdout.write(line + "\n")
        sys.stdout.flush()
        problems, kills = problems + len(report.problems), kills + report.killed.total()
    sys.stdout.write(f"{kills} kills in {how.runs} runs, {problems} problems\n")
    return int(problems > 0)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
