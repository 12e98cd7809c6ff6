"""JIT warm-up: a child process compiles the stages' loops, and frees the compiler's memory.

The compiler leaves half as much memory again in a process as the stream needs. A child therefore
compiles on a small street and leaves the loops in numba's cache on disk, from which workers load
them.
"""

import fcntl
import hashlib
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Final

import numpy as np
import structlog

from schemas.contradiction import LabelledFrame, Scene
from schemas.frame import PosedFrame
from schemas.labels import FrameLabels, MotionLabel
from schemas.task import MOTION
from workers.contradiction.agreement import compare
from workers.points.compiled import COMPILED, cache_folder
from workers.points.point_kernels import within
from workers.sources import source_digest

log = structlog.get_logger(__name__)

_CHILD_S: Final = 3600.0
"""Time limit of the child, seconds.

It takes fifteen to thirty seconds on a quiet core; ten minutes were measured on one shared by
fourteen."""


def compile_in_child() -> None:
    """Compile the loops of the default stream in a child process, once per machine.

    Of several processes that begin at once, one compiles and the others wait for it. Where the
    cache cannot be written, or the child fails, a warning is logged and this process compiles.
    """
    folder = cache_folder(within)
    if folder is None:
        return  # logged where the loops were made
    marker = Path(folder) / _marker()
    if marker.exists():
        return
    try:
        with _locked(marker.with_suffix(".lock")):
            if not marker.exists():
                log.info("compiling loops, once for this version", folder=folder)
                _in_child()
                marker.touch()
    except (OSError, subprocess.SubprocessError) as error:
        log.warning(
            "loops not compiled in a child process: this process compiles them, with more memory",
            folder=folder,
            problem=str(error),
        )


def mine_warmup_scene() -> None:
    """Mine a small street with the default parts, so that every loop is called.

    Networks take no part; their loops are called separately. The supervised stream is replaced by
    one that labels every point dynamic, so that there are contradictions.
    """
    from workers.contradiction.cloud_statistics import cloud_statistics
    from workers.contradiction.feature_extraction import extract_features
    from workers.contradiction.instances import find_instances
    from workers.contradiction.tracks import associate_instances
    from workers.odometry.odometry import KissOdometry
    from workers.selfsupervised.stream import Registration
    from workers.warmup.loops import call_loops
    from workers.warmup.warmup_scene import warmup_frames
    from workers.witness.free_space import TwoSidedFreeSpace

    for with_beams in (True, False):
        posed = list(KissOdometry()(warmup_frames(with_beams=with_beams)))
        labelled = map(_labelled_dynamic, posed, Registration()(iter(posed)))
        scene = Scene("rehearsal/0", tuple(TwoSidedFreeSpace()(labelled)))
        cloud_statistics(scene.frames)
        instances = find_instances(scene, class_names=())
        extract_features(scene, instances, associate_instances(scene, instances))
    call_loops(next(warmup_frames(with_beams=True)))


def _labelled_dynamic(posed: PosedFrame, predictive: FrameLabels) -> LabelledFrame:
    count = len(posed.frame)
    semantic = FrameLabels(
        labels=np.full(count, MotionLabel.DYNAMIC, np.uint8),
        confidence=np.ones(count, np.float16),
    )
    agreements = compare(semantic.labels, predictive.labels, MOTION)
    return LabelledFrame(posed, semantic, predictive, agreements, MOTION)


def _marker() -> str:
    """Name everything that compiled code depends on: sources, compiler, processor."""
    from numba.core.registry import cpu_target

    processor = repr(cpu_target.target_context.codegen().magic_tuple())
    key = f"{source_digest(*COMPILED)} {metadata.version('numba')} {sys.version} {processor}"
    return f"loops-{hashlib.sha256(key.encode()).hexdigest()[:16]}.compiled"


def _in_child() -> None:
    subprocess.run(
        [sys.executable, "-m", "workers.warmup.jit_warmup"],
        check=True,
        capture_output=True,
        timeout=_CHILD_S,
    )


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Keep a lock between processes; it ends with its process, however that ends."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


if __name__ == "__main__":
    mine_warmup_scene()
