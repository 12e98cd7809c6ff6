import os
import subprocess
import sys
from pathlib import Path

RUN_ONE_LOOP = """
import numpy as np
from workers.compiling import compile_apart
from workers.visibility.passes import within

compile_apart()
print(within(np.ones((1, 3), np.float32), 0.0, 2.0).tolist())
"""
COMPILED_BEFORE = """
from pathlib import Path
from workers import compiling
from workers.visibility.compiled import cache_folder
from workers.visibility.passes import within

Path(cache_folder(within), compiling._marker()).touch()
compiling.compile_apart()
"""


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
