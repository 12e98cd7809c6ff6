"""Plots by matplotlib, which only pictures of the lab need."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

from schemas.errors import PermanentError


def need_matplotlib() -> None:
    """Refuse where matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        raise PermanentError("plots need matplotlib: install 'counterpoint[plots]'")


def load_pyplot() -> Any:
    """Load matplotlib's interface without a window."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    return pyplot


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure, whose folder is made if it is missing, and free its memory."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": None})
    load_pyplot().close(figure)
