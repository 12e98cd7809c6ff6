"""Peak memory of a process, which an operator must provide for a worker."""

import resource
import sys
from pathlib import Path


def peak_memory_bytes() -> int:
    """Return the peak memory of this program, as the kernel counts it.

    Linux's `ru_maxrss` also counts the parent's memory at the start of the process; the high-water
    mark of this program alone is in /proc.
    """
    status = Path("/proc/self/status")
    if status.exists():
        kib = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(kib.split()[1]) * 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
