"""The two plots of the calibration: speeds of static and dynamic points, spread of instances."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from schemas.motion_rule import KMH, MotionRule
from workers.lab.calibration.motion_thresholds import SPEED_EDGES, InstanceSpread, SpeedOverlap
from workers.lab.plots import load_pyplot, save_figure

_STATIC: Final = "#0072b2"
_DYNAMIC: Final = "#d55e00"


def draw_speeds(path: Path, found: SpeedOverlap, rule: MotionRule) -> None:
    """Draw both histograms of speed, and the slowest speed that the rule calls dynamic."""
    pyplot = load_pyplot()
    figure, axis = pyplot.subplots(figsize=(8, 4.2), constrained_layout=True)
    edges = SPEED_EDGES[:-1] / KMH
    for shares, colour, name in (
        (found.static, _STATIC, "static"),
        (found.dynamic, _DYNAMIC, "dynamic"),
    ):
        axis.step(edges, shares, where="post", color=colour, label=name)
        axis.fill_between(edges, shares, step="post", color=colour, alpha=0.2)
    axis.axvline(rule.min_speed_m_per_s / KMH, color="black", ls="--", label="slowest dynamic")
    axis.set_yscale("log")
    axis.set_xlabel("speed of the object flow, km/h (last bin: and more)")
    axis.set_ylabel("share of points")
    axis.set_title(f"overlap of static and dynamic points: {found.overlap:.2f}")
    axis.legend(frameon=False)
    save_figure(figure, path)


def draw_spreads(path: Path, found: Sequence[InstanceSpread], rule: MotionRule) -> None:
    """Draw the normalised deviation of static and dynamic instances as box plots."""
    pyplot = load_pyplot()
    figure, axis = pyplot.subplots(figsize=(6, 4.2), constrained_layout=True)
    groups = [
        [each.spread for each in found if each.dynamic is moves and np.isfinite(each.spread)]
        for moves in (False, True)
    ]
    axis.boxplot([group or [np.nan] for group in groups], showfliers=False)
    axis.set_xticks([1, 2], [f"{name} ({len(each)})" for name, each in _named(groups)])
    axis.axhline(rule.max_spread, color="black", ls="--", label="largest accepted spread")
    axis.set_ylabel("standard deviation of speed over its mean")
    axis.set_title("true instances, one value for each frame")
    axis.legend(frameon=False)
    save_figure(figure, path)


def _named(groups: Sequence[Sequence[float]]) -> list[tuple[str, Sequence[float]]]:
    return list(zip(("static", "dynamic"), groups, strict=True))
