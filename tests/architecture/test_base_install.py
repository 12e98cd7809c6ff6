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
