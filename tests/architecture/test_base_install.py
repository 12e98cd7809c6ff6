"""The service runs without torch: of the workers it reads no more than the catalogue of parts."""

import subprocess
import sys

import pytest

WEB = ("fastapi", "jinja2", "starlette", "uvicorn")
HEAVY = (*WEB, "torch", "kiss_icp", "sklearn", "scipy", "numba", "mcap", "pypatchworkpp")
CATALOGUE = {
    "workers",
    "workers.errors",
    "workers.parts",
    "workers.parts.catalogue",
    "workers.parts.factories",
    "workers.parts.files",
    "workers.parts.part",
}
"""Tables and functions that import nothing heavy before they are called."""


@pytest.mark.parametrize("module", ["service.cli.main", "service.app", "service.embedded"])
def test_importing_the_service_loads_no_more_of_the_workers_than_their_catalogue(
    module: str,
) -> None:
    code = f"import sys, {module}; print(*sys.modules)"
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    loaded = set(found.stdout.split())
    assert loaded & set(HEAVY) == set()
    assert {name for name in loaded if name.split(".")[0] == "workers"} <= CATALOGUE


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
