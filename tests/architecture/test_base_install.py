"""The service runs without torch: nothing it imports at start may pull in the workers."""

import subprocess
import sys

import pytest

HEAVY = ("torch", "kiss_icp", "sklearn", "scipy", "numba", "mcap", "pypatchworkpp", "workers")


@pytest.mark.parametrize("module", ["service.cli.main", "service.app", "service.embedded"])
def test_importing_the_service_loads_nothing_of_the_workers(module: str) -> None:
    code = f"import sys, {module}; print(*(m for m in {HEAVY!r} if m in sys.modules))"
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert found.stdout.split() == []


@pytest.mark.parametrize(
    ("module", "heavy"),
    [("workers.pool.local", ("torch", "scipy", "numba")), ("service.cli.__main__", ("typer",))],
)
def test_what_a_pool_and_its_workers_begin_with_loads_nothing_they_do_not_need(
    module: str, heavy: tuple[str, ...]
) -> None:
    code = f"import sys, {module}; print(*(m for m in {heavy!r} if m in sys.modules))"
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert found.stdout.split() == []
