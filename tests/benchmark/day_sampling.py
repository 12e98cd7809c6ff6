"""What a process holds of the machine, read from the kernel; and how that grows."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Held:
    """What one process holds now.

    Attributes:
        pss_mib: Its memory, shared pages by their share.
        handles: Open files and sockets.
        threads: Threads.
        cpu_s: Processor time since it started.
    """

    pss_mib: float
    handles: int
    threads: int
    cpu_s: float


def held_by(pid: int) -> Held:
    """Read what a process holds.

    Raises:
        OSError: If it is no more.
    """
    process = Path(f"/proc/{pid}")
    rollup = dict(
        line.split(":", maxsplit=1)
        for line in (process / "smaps_rollup").read_text().splitlines()[1:]
    )
    fields = (process / "stat").read_text().rpartition(")")[2].split()
    ticks = int(fields[11]) + int(fields[12])
    return Held(
        pss_mib=int(rollup["Pss"].split()[0]) / 1024,
        handles=len(os.listdir(process / "fd")),  # noqa: PTH208
        threads=int(fields[17]),
        cpu_s=ticks / os.sysconf("SC_CLK_TCK"),
    )


def growth_per_1000(
    scenes: NDArray[np.float64], values: NDArray[np.float64], *, warm: float
) -> float:
    """Fit how much a value grows with a thousand scenes, once this share of them has passed."""
    late = scenes >= warm * scenes.max()
    if np.unique(scenes[late]).size < 2:
        return 0.0
    return float(np.polyfit(scenes[late] / 1000.0, values[late], 1)[0]) + 0.0
