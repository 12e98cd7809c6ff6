"""Pickles of frames as pandas 0.25 to 1.2 wrote them, made without pandas."""

import gzip
import io
import pickle
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray


class _Plain:
    """Object that a pickle names by the class of pandas that it stands for."""

    state: Any

    def __getstate__(self) -> Any:
        return self.state


class DataFrame(_Plain):
    __module__ = "pandas.core.frame"


class BlockManager(_Plain):
    __module__ = "pandas.core.internals.managers"


class Index:
    __module__ = "pandas.core.indexes.base"


class RangeIndex:
    __module__ = "pandas.core.indexes.range"


def _new_Index(kind: type, stated: Mapping[str, Any]) -> Any:  # noqa: N802  # the name of pandas
    raise NotImplementedError


_new_Index.__module__ = "pandas.core.indexes.base"


class _Labels:
    """Labels of an axis, pickled as a call of `_new_Index`."""

    def __init__(self, kind: type, stated: Mapping[str, Any]) -> None:
        self._reduced = (_new_Index, (kind, dict(stated)))

    def __reduce__(self) -> tuple[Any, ...]:
        return self._reduced


def write_frame(
    path: Path, columns: Mapping[str, NDArray[Any]], *, index: NDArray[Any] | None = None
) -> None:
    """Write columns as a compressed pickle of a frame, a block for each type of values."""
    names = np.array(list(columns), object)
    count = len(next(iter(columns.values()))) if columns else 0
    axes = [
        _Labels(Index, {"data": names, "name": None}),
        _Labels(RangeIndex, {"name": None, "start": 0, "stop": count, "step": 1})
        if index is None
        else _Labels(Index, {"data": index, "name": None}),
    ]
    by_type: dict[str, list[int]] = {}
    for place, values in enumerate(columns.values()):
        by_type.setdefault(values.dtype.str, []).append(place)
    listed = list(columns.values())
    blocks = [
        {"values": np.stack([listed[n] for n in places]), "mgr_locs": np.array(places)}
        for places in by_type.values()
    ]
    manager, frame = BlockManager(), DataFrame()
    manager.state = (axes, [each["values"] for each in blocks], [], {"0.14.1": {
        "axes": axes, "blocks": blocks,
    }})  # fmt: skip
    frame.state = {"_data": manager, "_typ": "dataframe", "_metadata": [], "attrs": {}}
    buffer = io.BytesIO()
    with _named_as_pandas():
        pickle.Pickler(buffer, protocol=4).dump(frame)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(buffer.getvalue(), compresslevel=1))


@contextmanager
def _named_as_pandas() -> Iterator[None]:
    """Let the pickler find the stand-ins under the names of pandas."""
    kept = {name: each for name, each in sys.modules.items() if name.partition(".")[0] == "pandas"}
    for name in kept:
        del sys.modules[name]
    parents = ("pandas", "pandas.core", "pandas.core.internals", "pandas.core.indexes")
    made = {name: ModuleType(name) for name in parents}
    for each in (DataFrame, BlockManager, Index, RangeIndex, _new_Index):
        module = made.setdefault(each.__module__, ModuleType(each.__module__))
        setattr(module, each.__name__, each)
    sys.modules.update(made)
    try:
        yield
    finally:
        for name in made:
            del sys.modules[name]
        sys.modules.update(kept)
