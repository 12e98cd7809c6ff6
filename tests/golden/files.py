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


class UnknownNameError(Exception):
    """A file's name says not which frame it is of, so no part can be held against it."""


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
        AbsentError: If there is no such file, and later if an array is asked for that it has not.
    """
    with present(path).open("rb") as file, np.load(file, allow_pickle=False) as stored:
        return _Arrays({name: stored[name] for name in stored.files})


class _Arrays(dict[str, NDArray[Any]]):
    """Arrays of a file; one of another form lacks some."""

    def __missing__(self, name: str) -> NDArray[Any]:
        """Say that the file is of a form that no check knows."""
        raise AbsentError(f"the array {name}")


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
    """Return the frame number at the end of a file's name.

    Raises:
        UnknownNameError: If it does not end in a number.
    """
    number = file.stem.rpartition("_")[2]
    if not (number.isascii() and number.isdigit()):
        raise UnknownNameError(f"a name that ends in a frame number, not {file.name}")
    return int(number)
