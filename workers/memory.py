"""How much memory a process has held: what an operator must give a worker."""

import resource
import sys
from pathlib import Path


def peak_memory_bytes() -> int:
    """Return the most memory this program ever held, as the kernel counts it.

    Linux's `ru_maxrss` also counts what the parent held when it started us; its high-water mark of
    this program alone stands in /proc.
    """
    status = Path("/proc/self/status")
    if status.exists():
        kib = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(kib.split()[1]) * 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
