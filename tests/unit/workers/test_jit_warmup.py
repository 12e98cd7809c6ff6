import os
import re
import subprocess
import sys
from pathlib import Path

from tests.reference_folder import ROOT
from workers.points.compiled import COMPILED

RUN_ONE_LOOP = """
import numpy as np
from workers.warmup.jit_warmup import compile_in_child
from workers.points.point_kernels import within

compile_in_child()
print(within(np.ones((1, 3), np.float32), 0.0, 2.0).tolist())
"""
COMPILED_BEFORE = """
from pathlib import Path
from workers.warmup import jit_warmup
from workers.points.compiled import cache_folder
from workers.points.point_kernels import within

Path(cache_folder(within), jit_warmup._marker()).touch()
jit_warmup.compile_in_child()
"""


DECORATED = re.compile(r"^@(compiled|inlined)$", re.MULTILINE)


def test_every_module_with_compiled_loops_is_in_the_key_of_their_cache() -> None:
    packages = tuple(f"{each}." for each in COMPILED)
    with_loops = {
        ".".join(file.relative_to(ROOT).with_suffix("").parts)
        for file in (ROOT / "workers").rglob("*.py")
        if DECORATED.search(file.read_text(encoding="utf-8"))
    }
    assert len(with_loops) > 20
    assert [each for each in sorted(with_loops) if not f"{each}.".startswith(packages)] == []


def run(code: str, cache: Path) -> str:
    """Run code in a process that may keep compiled loops in one folder and nowhere else."""
    only_there = {
        "NUMBA_CACHE_DIR": str(cache),
        "NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator",
    }
    ended = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **only_there},
    )
    return ended.stdout + ended.stderr


def test_where_no_cache_can_be_written_that_is_said_once_and_loops_work_all_the_same(
    tmp_path: Path,
) -> None:
    nowhere = tmp_path / "file"
    nowhere.touch()
    said = run(RUN_ONE_LOOP, nowhere / "below")
    assert said.count("NUMBA_CACHE_DIR") == 1
    assert "[True]" in said


def test_what_was_compiled_before_is_not_compiled_again(tmp_path: Path) -> None:
    said = run(COMPILED_BEFORE, tmp_path)
    assert "compiling" not in said
    kept = [path.suffix for path in tmp_path.rglob("*") if path.is_file()]
    assert kept == [".compiled"]
