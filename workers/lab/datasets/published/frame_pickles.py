"""Pickled pandas frames, read without pandas and without running anything that they name.

A pickle is a program that may call any function. Here each name that it may look up leads to a
plain holder of this module, so that a file can only build tables of numbers and text.

Sources: docs.python.org, pickle, restricting globals; forms of pandas 0.25 to 2.3.
"""

import gzip
import io
import pickle
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from workers.lab.datasets.conversion.source import DatasetUnusableError
from workers.lab.datasets.published.files import read_bytes

MAX_BYTES: Final = 1 << 30
"""Largest file after decompression, bytes; a frame of PandaSet has 12 MB."""

_KINDS: Final = "biufOSUmM"


class PickleRefusedError(DatasetUnusableError):
    """A pickle names something that no table needs."""


class _Type:
    """Type of the values of an array."""

    def __init__(self, name: str, align: bool = False, copy: bool = False) -> None:
        found = np.dtype(str(name))
        if found.kind not in _KINDS:
            raise ValueError(f"type {name!r}")
        self.dtype = found

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        if state[1] in ("<", ">", "="):
            self.dtype = self.dtype.newbyteorder(state[1])


class _Array:
    """Array that its state fills."""

    def __init__(self, *_: object) -> None:
        self.values: NDArray[Any] = np.empty(0)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, shape, kind, fortran, data = state
        if kind.dtype.kind == "O":
            flat = np.empty(len(data), object)
            flat[:] = data
        else:
            flat = np.frombuffer(data if isinstance(data, bytes) else bytes(data), kind.dtype)
        sides = tuple(int(each) for each in shape)
        self.values = flat.reshape(sides[::-1]).T if fortran else flat.reshape(sides)


def _array_of_buffer(data: bytes, kind: _Type, shape: tuple[int, ...], order: str) -> _Array:
    array = _Array()
    array.__setstate__((1, shape, kind, order == "F", bytes(data)))
    return array


def _scalar(kind: _Type, data: bytes = b"") -> Any:
    return np.frombuffer(data, kind.dtype)[0].item()


class _Holder:
    """Object of pandas: keeps its arguments and its state."""

    def __init__(self, *arguments: Any) -> None:
        self.arguments = arguments
        self.state: Any = None

    def __setstate__(self, state: Any) -> None:
        self.state = state


class _Kind:
    """Class of pandas by its name, which is only ever an argument."""

    def __init__(self, name: str) -> None:
        self.name = name


class _Index(_Holder):
    """Labels of an axis."""

    def labels(self) -> list[Any]:
        stated: Mapping[str, Any] = self.arguments[1]
        if "data" in stated:
            found: list[Any] = _values(stated["data"]).tolist()
            return found
        return list(range(stated["start"], stated["stop"], stated["step"]))


class _Block(_Holder):
    """Columns of one type."""


class _Manager(_Holder):
    """Blocks and axes of a frame."""

    @classmethod
    def of(cls, *arguments: Any) -> Self:
        return cls(*arguments)


class _Frame(_Holder):
    """A frame."""


_INDEX_CLASSES: Final = (
    *("pandas.core.indexes.base.Index", "pandas.core.indexes.range.RangeIndex"),
    *("pandas.core.indexes.numeric.Int64Index", "pandas.core.indexes.numeric.UInt64Index"),
    "pandas.core.indexes.numeric.Float64Index",
)
_ARRAY: Final = _Kind("numpy.ndarray")

_ALLOWED: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "numpy.core.multiarray._reconstruct": _Array,
        "numpy._core.multiarray._reconstruct": _Array,
        "numpy.core.multiarray.scalar": _scalar,
        "numpy._core.multiarray.scalar": _scalar,
        "numpy.core.numeric._frombuffer": _array_of_buffer,
        "numpy._core.numeric._frombuffer": _array_of_buffer,
        "numpy.ndarray": _ARRAY,
        "numpy.dtype": _Type,
        "builtins.slice": slice,
        "pandas.core.frame.DataFrame": _Frame,
        "pandas.core.internals.managers.BlockManager": _Manager,
        "pandas.core.internals.blocks.new_block": _Block,
        "pandas._libs.internals._unpickle_block": _Block,
        "pandas._libs.internals.BlockPlacement": _Holder,
        "pandas.core.indexes.base._new_Index": _Index,
        **{name: _Kind(name) for name in _INDEX_CLASSES},
    }
)


class _Unpickler(pickle.Unpickler):
    """Builds holders of this module alone."""

    def find_class(self, module: str, name: str) -> Any:
        found = _ALLOWED.get(f"{module}.{name}")
        if found is None:
            raise PickleRefusedError(f"it names {module}.{name}")
        return found

    def persistent_load(self, pid: Any) -> Any:
        raise PickleRefusedError("it refers to objects outside of it")


def read_frame(path: Path) -> dict[str, NDArray[Any]]:
    """Read a pickled frame, compressed by gzip or not.

    Args:
        path: `NN.pkl.gz` or `NN.pkl`.

    Returns:
        Columns by name, each (N,), in the order of the file; and the labels of the rows as `index`.

    Raises:
        PickleRefusedError: If it names anything but tables; nothing of it was run.
        DatasetUnusableError: If it is cut or no frame.
    """
    data = read_bytes(path)
    if data[:2] == b"\x1f\x8b":
        data = _decompressed(data, path)
    try:
        frame = _Unpickler(io.BytesIO(data)).load()
        if not isinstance(frame, _Frame):
            raise ValueError("it is no frame")
        return _columns(frame.state)
    except PickleRefusedError as error:
        raise PickleRefusedError(
            f"refused {path}: {error}, and a table needs no such thing; nothing of the file was run"
        ) from None
    except (
        *(pickle.UnpicklingError, EOFError, ValueError, TypeError, KeyError, IndexError),
        *(AttributeError, OverflowError, MemoryError, RecursionError, NotImplementedError),
    ) as error:
        raise DatasetUnusableError(
            f"no pandas frame that can be read: {type(error).__name__}: {error} ({path})"
        ) from None


def _decompressed(data: bytes, path: Path) -> bytes:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            plain = stream.read(MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise DatasetUnusableError(f"the file is cut or damaged: {error} ({path})") from None
    if len(plain) > MAX_BYTES:
        raise DatasetUnusableError(f"more than {MAX_BYTES} bytes after decompression ({path})")
    return plain


def _values(found: Any) -> NDArray[Any]:
    if not isinstance(found, _Array):
        raise TypeError("values that are no array of numpy")
    return found.values


def _columns(state: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    manager = state["_mgr"] if "_mgr" in state else state["_data"]
    axes, blocks = _MANAGER_FORMS[isinstance(manager.state, tuple)](manager)
    names, rows = axes[0].labels(), axes[1].labels()
    columns: dict[str, NDArray[Any]] = {}
    for values, where in blocks:
        block = np.atleast_2d(_values(values))
        for row, place in zip(block, _places(where), strict=True):
            columns[str(names[place])] = row
    if len(columns) != len(names) or any(len(each) != len(rows) for each in columns.values()):
        raise ValueError("columns are missing")
    return {"index": np.asarray(rows), **{str(name): columns[str(name)] for name in names}}


def _blocks_of_state(manager: _Manager) -> tuple[list[Any], list[tuple[Any, Any]]]:
    """Read the form of pandas before 1.3: a tuple, whose fourth part has places."""
    stated = manager.state[3]["0.14.1"]
    return stated["axes"], [(each["values"], each["mgr_locs"]) for each in stated["blocks"]]


def _blocks_of_arguments(manager: _Manager) -> tuple[list[Any], list[tuple[Any, Any]]]:
    """Read the form of pandas from 1.3 on: blocks, then axes."""
    blocks, axes = manager.arguments[:2]
    return axes, [each.arguments[:2] for each in blocks]


_MANAGER_FORMS: Final[
    Mapping[bool, Callable[[_Manager], tuple[list[Any], list[tuple[Any, Any]]]]]
] = {True: _blocks_of_state, False: _blocks_of_arguments}


def _places(where: Any) -> list[int]:
    if isinstance(where, _Holder):
        where = where.arguments[0]
    if isinstance(where, slice):
        return list(range(where.start, where.stop, where.step or 1))
    return [int(each) for each in _values(where)]
