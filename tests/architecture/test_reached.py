"""No module is there for tests alone: every one is reached from a command or from the client."""

import importlib.util
from pathlib import Path
from typing import Final

import grimp

ENTRIES: Final = {"service.cli.__main__", "service.client"}
"""What users start, and what they import; with them every module that `python -m` runs."""


def is_run_by_itself(module: str) -> bool:
    spec = importlib.util.find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    return 'if __name__ == "__main__"' in Path(spec.origin).read_text(encoding="utf-8")


def test_every_module_is_reached_from_a_command_or_the_client() -> None:
    graph = grimp.build_graph("schemas", "service", "workers", cache_dir=None)
    reached = set[str]()
    waiting = ENTRIES | {module for module in graph.modules if is_run_by_itself(module)}
    assert "workers.lab.training.attribution" in waiting
    while waiting:
        module = waiting.pop()
        reached.add(module)
        package = {module.rpartition(".")[0]} & graph.modules
        waiting |= (graph.find_modules_directly_imported_by(module) | package) - reached
    assert graph.modules - reached == set()
