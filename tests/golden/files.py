"""How checks read reference outputs: one that needs an absent file says so."""

import importlib.util
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]


class AbsentError(Exception):
    """A check needs a file that the folder has not."""


def present(path: Path) -> Path:
    """Return the path.

    Raises:
        AbsentError: If there is no such file.
    """
    if not path.is_file():
        raise AbsentError(f"{path.parent.name}/{path.name}")
    return path


def arrays(path: Path) -> Arrays:
    """Read all arrays of a file.

    Raises:
        AbsentError: If there is no such file.
    """
    with present(path).open("rb") as file, np.load(file, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def document(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        AbsentError: If there is no such file.
    """
    return json.loads(present(path).read_text(encoding="utf-8"))


def parameters(folder: Path, network: str) -> Arrays:
    """Fill a network's parameters as the folder's recipe says, by key without prefix.

    Raises:
        AbsentError: If the recipe, or the list of parameters, is absent.
    """
    recipe = present(folder / "fill_parameters.py")
    listed = present(folder / "networks" / f"{network}_parameters.json")
    spec = importlib.util.spec_from_file_location("fill_parameters", recipe)
    if spec is None or spec.loader is None:
        raise ImportError(f"cannot load the recipe {recipe}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    filled: Arrays = module.fill(listed)
    return filled


def number_of(file: Path) -> int:
    """Frame number at the end of a file's name."""
    return int(file.stem.rsplit("_", 1)[-1])
