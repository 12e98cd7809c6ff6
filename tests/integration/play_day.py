"""Plays a day of a log bucket for a person: `python -m tests.integration.play_day --seed 7`.

With `--s3 FOLDER` the bucket lies on a Ceph gateway, which is started by that folder's scripts.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from schemas.runtime.process import log_to_stderr
from tests.integration.bucket_hand import FolderHand, Hand, S3Hand
from tests.integration.day_blows import BLOWS
from tests.integration.day_system import play
from tests.integration.object_store import Ceph


def main() -> int:
    """Play, and say how it ended; 1 if the evening is not what a fresh run finds."""
    asked = argparse.ArgumentParser(prog="python -m tests.integration.play_day")
    asked.add_argument("--seed", type=int, default=1, help="makes up the day")
    asked.add_argument("--s3", type=Path, help="folder of ceph-up.sh; a local folder without")
    asked.add_argument("--blows", help="only these, with commas: " + ", ".join(BLOWS))
    asked.add_argument("--keep", type=Path, help="folder for states and logs, else thrown away")
    how = asked.parse_args()
    log_to_stderr(level="error")
    with tempfile.TemporaryDirectory(prefix="day-") as thrown_away:
        folder = how.keep or Path(thrown_away)
        folder.mkdir(parents=True, exist_ok=True)
        with _bucket(folder, how.s3) as (hand, env):
            _say(f"seed {how.seed}, bucket {hand.url}, state and logs in {folder}")
            struck = [blow for blow in BLOWS if blow in how.blows.split(",")] if how.blows else None
            evening = play(folder, hand, seed=how.seed, env=env, say=_say, struck=struck)
    _say("")
    for line in evening.tally.lines():
        _say(line)
    differences = evening.differences()
    for line in differences:
        _say(f"DIFFERS   {line}")
    if differences:
        _say(f"verdict   {len(differences)} differences from a fresh run")
    else:
        _say(
            "verdict   the same as a fresh run, byte for byte: top, status, rates, overlays, and "
            f"{len(evening.fresh.records)} records as ledger and subscribers have them"
        )
    return 1 if differences else 0


@contextmanager
def _bucket(folder: Path, s3: Path | None) -> Iterator[tuple[Hand, dict[str, str]]]:
    if s3 is None:
        yield FolderHand(folder / "logs"), {}
        return
    with tempfile.TemporaryDirectory(prefix="ceph-") as short:  # sockets are made in it
        ceph = Ceph(s3.resolve(), Path(short))
        try:
            ceph.up()
            yield S3Hand(ceph), ceph.environment()
        finally:
            ceph.down()


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
