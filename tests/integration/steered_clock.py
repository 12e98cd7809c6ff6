"""A system clock that a file sets while processes run; their monotonic clock stays untouched.

A small library is built with the C compiler and loaded before others. Debian's libfaketime cannot
be used: under its version 0.9.10 `time.sleep` of Python 3.11 ends with EINVAL at once.
"""

import ctypes
import os
import shutil
import struct
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tests.needed import need

STEP: Final = "CLOCK_STEP"
"""Variable with the path of the file that says how far a process's clock is ahead."""

_SOURCE: Final = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static const volatile long *step_s;

__attribute__((constructor)) void follow_clock(void) {
    int file = open(getenv("CLOCK_STEP"), O_RDONLY);
    const volatile long *found = mmap(NULL, sizeof *found, PROT_READ, MAP_SHARED, file, 0);
    if (found == MAP_FAILED) abort();
    close(file);
    step_s = found;
}

int clock_gettime(clockid_t id, struct timespec *now) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int failed = real(id, now);
    if (!failed && step_s && (id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE))
        now->tv_sec += *step_s;
    return failed;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
    struct timespec found;
    if (clock_gettime(CLOCK_REALTIME, &found)) return -1;
    now->tv_sec = found.tv_sec;
    now->tv_usec = found.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *now) {
    struct timespec found;
    if (clock_gettime(CLOCK_REALTIME, &found)) return -1;
    if (now) *now = found.tv_sec;
    return found.tv_sec;
}
"""


def compiler() -> str | None:
    """Return the path of the C compiler; None: there is none."""
    return shutil.which("cc")


def build_clock(folder: Path) -> Path:
    """Build the library in a folder, and return its path."""
    found = compiler() or need("this test builds a clock: it needs a C compiler (gcc)")
    source, library = folder / "clock.c", folder / "clock.so"
    source.write_text(_SOURCE)
    built = [found, "-shared", "-fPIC", "-O2", "-o", str(library), str(source), "-ldl"]
    subprocess.run(built, check=True)
    return library


@dataclass(frozen=True)
class SteeredClock:
    """A system clock that is ahead of the machine's by what a file says.

    Attributes:
        step: That file.
        library: The built library.
    """

    step: Path
    library: Path

    @property
    def env(self) -> dict[str, str]:
        """Variables under which a process has this clock."""
        return {"LD_PRELOAD": str(self.library), STEP: str(self.step)}

    def set(self, step_s: int) -> None:
        """Set the clock of the processes that run, and of later ones, seconds ahead."""
        with self.step.open("r+b" if self.step.exists() else "wb") as file:
            file.write(struct.pack("l", step_s))


def steered_clock(folder: Path) -> SteeredClock:
    """Build a clock that is right, within a folder."""
    clock = SteeredClock(folder / "step", build_clock(folder))
    clock.set(0)
    return clock


def follow_own_clock() -> None:
    """Have a forked process follow the file of its own environment."""
    if STEP in os.environ:
        ctypes.CDLL(None).follow_clock()
