"""Only one place writes to a terminal: there what others wrote is made visible."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
PLACES: Final = {
    "service/cli/output.py": "the one place of the command",
    "schemas/runtime/process.py": "the log of every process",
}
"""Files that may write to the terminal, each with the reason."""

_STREAMS: Final = {"stdout", "stderr", "__stdout__", "__stderr__"}


def writes(path: Path) -> Iterator[str]:
    """Yield each expression of a file that writes to the terminal by itself."""
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Call):
            continue
        function = node.func
        if isinstance(function, ast.Name) and function.id in ("print", "Console"):
            yield f"line {node.lineno}: {function.id}"
        if isinstance(function, ast.Attribute):
            of = ast.unparse(function.value)
            to_stream = function.attr in ("write", "writelines") and of.split(".")[-1] in _STREAMS
            if to_stream or (function.attr == "echo" and of in ("typer", "click")):
                yield f"line {node.lineno}: {of}.{function.attr}"
            if function.attr == "print" and of in ("results", "remarks", "console", "rich"):
                yield f"line {node.lineno}: {of}.print"


def test_only_one_place_prints() -> None:
    found = {
        path.relative_to(ROOT).as_posix(): list(writes(path))
        for package in ("schemas", "service", "workers")
        for path in (ROOT / package).rglob("*.py")
    }
    assert {name: seen for name, seen in found.items() if seen and name not in PLACES} == {}
    assert all(found[name] for name in PLACES), "a place that prints no more is taken off the list"
