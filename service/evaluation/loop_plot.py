"""The curves of the loop as a picture."""

from pathlib import Path
from typing import Final

from service.evaluation.loop_figure import ALARMS, LoopFigure
from workers.lab.plots import load_pyplot, save_figure

_TITLES: Final = {
    "moving": "all moving pixels",
    "unknown": "unknown classes",
    "rain": "all moving pixels in rain",
}
_COLOURS: Final = ("#d55e00", "#0072b2", "#555555", "#009e73", "#cc79a7")


def draw_curves(path: Path, figure: LoopFigure) -> None:
    """Draw the share of pixels found against the labelled scenes, with 95 % bands."""
    pyplot = load_pyplot()
    drawn, axes = pyplot.subplots(1, 3, figsize=(13, 4.2), constrained_layout=True)
    start = [row for row in figure.rows if not row.order]
    orders = list(dict.fromkeys(row.order for row in figure.rows if row.order))
    for axis, (measure, title) in zip(axes, _TITLES.items(), strict=True):
        for order, colour in zip(orders, _COLOURS, strict=False):
            rows = [*start, *(row for row in figure.rows if row.order == order)]
            budgets = [row.budget for row in rows]
            axis.plot(budgets, [r.found[measure] for r in rows], "o-", color=colour, label=order)
            axis.fill_between(
                budgets,
                [row.interval[measure][0] for row in rows],
                [row.interval[measure][1] for row in rows],
                color=colour,
                alpha=0.08,
            )
        axis.set_title(title)
        axis.set_xlabel(f"labelled scenes of {figure.fleet_scenes}")
        axis.set_ylabel(f"share found at {ALARMS:.0%} false alarms")
    axes[0].legend(frameon=False)
    save_figure(drawn, path)
