"""Feather files as columns of numpy, read by pyarrow (extra `datasets`)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.lab.datasets.conversion.source import DatasetUnusableError


def read_feather(path: Path, columns: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Read the named columns of a feather file.

    Returns:
        (N,) arrays by name.

    Raises:
        DatasetUnusableError: If pyarrow, the file or a column is missing, or the file is cut.
    """
    try:
        from pyarrow import ArrowException, feather
    except ImportError:
        raise DatasetUnusableError(
            "feather files need pyarrow: pip install 'counterpoint[datasets]'"
        ) from None
    if not path.is_file():
        raise DatasetUnusableError(f"no such file: {path}")
    try:
        table = feather.read_table(str(path), memory_map=False)
        lacking = [name for name in columns if name not in table.column_names]
        if lacking:
            raise DatasetUnusableError(f"no column {lacking[0]} in {path}")
        return {name: np.asarray(table[name].to_numpy(zero_copy_only=False)) for name in columns}
    except (ArrowException, OSError, ValueError) as error:
        raise DatasetUnusableError(
            f"the feather file is cut or damaged: {_short(error)} ({path})"
        ) from None


def _short(error: Exception) -> str:
    return str(error).splitlines()[0][:120] if str(error) else type(error).__name__
