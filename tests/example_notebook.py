"""Example notebook: `python -m tests.example_notebook STATE` executes it on a state, in its place.

The state is a small simulated one, such as `state` of `counterpoint demo`; its page is served here.
"""

import json
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nbformat
from nbclient import NotebookClient

from tests.contracts.served_api import served_api

NOTEBOOK = Path(__file__).resolve().parents[1] / "deploy" / "examples" / "notebook.ipynb"

USUAL = "http://127.0.0.1:8087"
"""Address of the page in the notebook."""

TIMEOUT_S = 120
"""Time for one cell on a busy machine, seconds."""

_SHOWN = {"text/plain", "text/html", "image/png"}
"""Forms of an output that are kept; a picture comes as a JPEG too."""


def executed(url: str, folder: Path) -> dict[str, Any]:
    """Return the notebook after all its cells ran against a page.

    Raises:
        CellExecutionError: If a cell fails.
    """
    notebook = nbformat.read(NOTEBOOK, as_version=4)  # type: ignore[no-untyped-call]
    _replace(notebook, USUAL, url)
    client = NotebookClient(
        notebook,
        timeout=TIMEOUT_S,
        record_timing=False,
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute(env=os.environ | {"IPYTHONDIR": str(folder / "ipython")})
    _replace(notebook, url, USUAL)
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            for form in set(data) - _SHOWN:
                del data[form]
    ran: dict[str, Any] = json.loads(nbformat.writes(notebook))  # type: ignore[no-untyped-call]
    return ran


def _replace(notebook: nbformat.NotebookNode, address: str, by: str) -> None:
    for cell in notebook.cells:
        cell.source = cell.source.replace(address, by)


def main(state: str) -> None:
    """Execute the notebook on a state, and store it with its outputs."""
    with served_api(Path(state)) as served, TemporaryDirectory() as folder:
        ran = executed(served.url, Path(folder))
    ran["metadata"]["language_info"] = {"name": "python"}
    NOTEBOOK.write_text(json.dumps(ran, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
