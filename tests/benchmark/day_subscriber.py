"""A subscriber for a day in minutes: notes when each scene arrived."""

import sys
import time
from pathlib import Path

from schemas.runtime.process import stop_on_signals
from schemas.runtime.retry import StoppedError
from service.client import watch_scenes


def main(endpoint: str, arrivals: str) -> None:
    """Watch until told to stop."""
    with stop_on_signals() as stop, Path(arrivals).open("w", buffering=1) as noted:
        try:
            for event in watch_scenes([endpoint], stop=stop):
                now_s = time.clock_gettime(time.CLOCK_REALTIME)
                noted.write(f"{now_s:.6f}\t{event.seq}\t{event.scene_id}\t{event.sha256}\n")
        except StoppedError:
            return


if __name__ == "__main__":
    main(*sys.argv[1:])
