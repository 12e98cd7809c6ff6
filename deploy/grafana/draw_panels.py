"""Drawing of both dashboards into pictures, without a Grafana.

    python -m deploy.grafana.draw_panels --prometheus 127.0.0.1:9090 --service 127.0.0.1:9464

The pictures are not Grafana's own, but use the same queries, variables, units and colours.
"""

import argparse
import json
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib import dates
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray
from PIL import Image

from deploy.grafana.asking import AnswerError, Series, query, query_range, rates
from deploy.grafana.panels import COLUMNS
from deploy.grafana.reading import FOLDER, ReadPanel, Target, read_dashboard, variables_of
from deploy.grafana.units import written

WIDTH_IN: Final = 20.0
ROW_IN: Final = 0.36
DPI: Final = 68
STEPS: Final = 200
COLOURS_OF_PICTURE: Final = 96
DAY_S: Final = 86_400
LONGEST_GAP_S: Final = 120.0
"""Longest gap that a line bridges, seconds, as the panels configure it in Grafana."""

LETTERS_PER_GRID_COLUMN: Final = 14.0
LETTERS_OF_A_HANDLE: Final = 5
"""Width of a legend's handle in letters, measured on the picture."""

BACKGROUND, FOREGROUND, FAINT = "#15171c", "#d5d8dd", "#3a3d45"
COLOURS: Final = {"green": "#3f833b", "yellow": "#b58b00", "red": "#b3261e"}
LINES: Final = ("#56a64b", "#e0b400", "#3274d9", "#e0752d", "#c4162a", "#8f3bb8", "#37b5b6", "#888")


@dataclass(frozen=True, slots=True)
class View:
    """View of a dashboard: two addresses, a time range, and the values of the variables."""

    prometheus: str
    service: str
    start_s: float
    end_s: float
    variables: dict[str, str]

    @property
    def step_s(self) -> float:
        """Interval between two points of a line, seconds."""
        return max(1.0, (self.end_s - self.start_s) / STEPS)


def draw(path: Path, view: View, out: Path) -> None:
    """Draw one dashboard's file into a picture."""
    raw = json.loads(path.read_text(encoding="utf-8"))
    rows = max(p["gridPos"]["y"] + p["gridPos"]["h"] for p in raw["panels"])
    figure = Figure(figsize=(WIDTH_IN, rows * ROW_IN), facecolor=BACKGROUND)
    for heading in (p for p in raw["panels"] if p["type"] == "row"):
        at = 1 - (heading["gridPos"]["y"] + 0.75) / rows
        figure.text(0.006, at, heading["title"], color=FOREGROUND, size=12, weight="bold")
    for panel in read_dashboard(path):
        _draw_panel(figure.add_axes(_place(panel, rows)), panel, view)
    drawn = BytesIO()
    figure.savefig(drawn, dpi=DPI, facecolor=BACKGROUND, format="png")
    with Image.open(drawn) as image:  # few colours: a third of the bytes
        image.convert("RGB").quantize(COLOURS_OF_PICTURE).save(out, optimize=True)


def _place(panel: ReadPanel, rows: int) -> tuple[float, float, float, float]:
    """Return left, bottom, width and height of the axes inside their cell, as shares."""
    grid = panel.raw["gridPos"]
    left, right, above, below = _MARGINS[panel.kind]
    return (
        (grid["x"] + left) / COLUMNS,
        1 - (grid["y"] + grid["h"] - below) / rows,
        (grid["w"] - left - right) / COLUMNS,
        (grid["h"] - above - below) / rows,
    )


_MARGINS: Final = {
    "timeseries": (0.9, 0.25, 1.1, 1.9),
    "heatmap": (0.9, 0.25, 1.1, 1.2),
    "barchart": (0.9, 0.25, 1.1, 1.9),
    "stat": (0.25, 0.1, 1.2, 0.3),
}
"""Margins left, right, above and below, in columns and rows of Grafana's grid."""


def _draw_panel(axes: Axes, panel: ReadPanel, view: View) -> None:
    axes.set_facecolor(BACKGROUND)
    axes.set_title(panel.title, color=FOREGROUND, size=9, loc="left", pad=4)
    axes.tick_params(colors=FOREGROUND, labelsize=7, length=2)
    for spine in axes.spines.values():
        spine.set_color(FAINT)
    _DRAWN[panel.kind](axes, panel, view)


def _draw_lines(axes: Axes, panel: ReadPanel, view: View) -> None:
    unit, custom = _unit(panel), panel.raw["fieldConfig"]["defaults"]["custom"]
    lines = [(t, s) for t in panel.targets for s in _over_time(t, view) if s.samples]
    names = [_name(target, series) for target, series in lines]
    colours = [_own_colour(panel, n) or LINES[i % len(LINES)] for i, n in enumerate(names)]
    if "stacking" in custom and lines:
        at_s = np.unique([at for _, series in lines for at, _ in series.samples])
        at_s = np.arange(at_s[0], at_s[-1] + 1, view.step_s)
        values = [_on_grid(series, at_s, view.step_s) for _, series in lines]
        axes.stackplot(at_s / DAY_S, values, colors=colours, labels=names, alpha=0.7)
    else:
        for (_, series), name, colour in zip(lines, names, colours, strict=True):
            at_s, line = _with_gaps(series, longest_s=LONGEST_GAP_S)
            axes.plot(at_s / DAY_S, line, color=colour, label=name, linewidth=1.2)
    if not lines:
        _say_nothing(axes)
        return
    for step in panel.raw["fieldConfig"]["defaults"]["thresholds"]["steps"][1:]:
        if step["value"] <= axes.get_ylim()[1] * 1.5:
            axes.axhline(step["value"], color=COLOURS[step["color"]], linewidth=1, linestyle="--")
    axes.set_xlim(view.start_s / DAY_S, view.end_s / DAY_S)
    axes.set_ylim(0, 1.06 * axes.get_ylim()[1])  # a line that hardly moves must not be the frame
    _write_axes(axes, unit)
    axes.legend(
        loc="upper left",
        bbox_to_anchor=(-0.02, -0.14),
        ncols=_legend_columns(names, grid_columns=panel.raw["gridPos"]["w"]),
        fontsize=6.5,
        frameon=False,
        labelcolor=FOREGROUND,
        handlelength=1,
        columnspacing=1,
    )


def _legend_columns(names: Sequence[str], *, grid_columns: int) -> int:
    """Return how many names fit on a line of a legend; many short ones would overflow the next."""
    letters = LETTERS_PER_GRID_COLUMN * grid_columns
    return max(1, int(letters / (max(map(len, names)) + LETTERS_OF_A_HANDLE)))


def _on_grid(series: Series, at_s: NDArray[np.float64], step_s: float) -> NDArray[np.float64]:
    """Return the values at these instants, 0 where there is none, as a stack needs them."""
    known = {round((at - at_s[0]) / step_s): value for at, value in series.samples}
    return np.array([known.get(step, 0.0) for step in range(len(at_s))])


def _with_gaps(
    series: Series, *, longest_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times and values, with a break where a line would bridge too long a gap."""
    at_s, values = (np.array(column) for column in zip(*series.samples, strict=True))
    breaks = np.flatnonzero(np.diff(at_s) > longest_s) + 1
    return np.insert(at_s, breaks, at_s[breaks - 1]), np.insert(values, breaks, np.nan)


def _draw_number(axes: Axes, panel: ReadPanel, view: View) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    found = query(view.prometheus, panel.targets[0].filled(view.variables), at_s=view.end_s)
    values = [value for series in found for _, value in series.samples]
    if not values:
        _say_nothing(axes)
        return
    defaults = panel.raw["fieldConfig"]["defaults"]
    steps = [
        s for s in defaults["thresholds"]["steps"] if s["value"] is None or values[0] >= s["value"]
    ]
    axes.set_facecolor(COLOURS[steps[-1]["color"]])
    said = written(values[0], _unit(panel), decimals=defaults.get("decimals"))
    axes.text(
        0.5, 0.5, said, color="white", size=18, ha="center", va="center", transform=axes.transAxes
    )


def _draw_heatmap(axes: Axes, panel: ReadPanel, view: View) -> None:
    buckets = sorted(_over_time(panel.targets[0], view), key=lambda s: float(s.labels["le"]))
    at_s = np.unique([at for series in buckets for at, _ in series.samples])
    if not len(at_s):
        _say_nothing(axes)
        return
    cumulated = np.array([[dict(series.samples).get(at, 0.0) for at in at_s] for series in buckets])
    counts = np.diff(cumulated, axis=0, prepend=0)
    edges = [series.labels["le"] for series in buckets]
    mesh = axes.pcolormesh(
        at_s / DAY_S, np.arange(len(edges)), np.where(counts > 1e-9, counts, np.nan),
        cmap="Oranges_r", shading="nearest",
    )  # fmt: skip
    axes.set_yticks(range(len(edges)), edges)
    axes.set_xlim(view.start_s / DAY_S, view.end_s / DAY_S)
    axes.xaxis.set_major_formatter(FuncFormatter(_clock))
    bar = axes.figure.colorbar(mesh, ax=axes, pad=0.01)
    bar.ax.tick_params(colors=FOREGROUND, labelsize=6)


def _draw_bars(axes: Axes, panel: ReadPanel, view: View) -> None:
    target = panel.targets[0]
    most = panel.raw["transformations"][0]["options"]["limitField"]
    rows = rates(view.service, target.filled(view.variables))[:most]
    if not rows:
        _say_nothing(axes)
        return
    base = np.zeros(len(rows))
    for number, name in enumerate(target.values):
        values = np.array([row[name] for row in rows])
        colour = _own_colour(panel, name) or LINES[number]
        axes.bar(range(len(rows)), values, bottom=base, color=colour, label=name, width=0.7)
        base += values
    labels = [_shortened(row["group"]) for row in rows]
    axes.set_xticks(range(len(rows)), labels, rotation=12, ha="right", size=6.5)
    axes.set_xlim(-0.7, max(len(rows), 3) - 0.3)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: written(value, _unit(panel))))
    axes.legend(loc="upper right", fontsize=6.5, frameon=False, labelcolor=FOREGROUND)


_DRAWN: Final = {
    "timeseries": _draw_lines,
    "stat": _draw_number,
    "heatmap": _draw_heatmap,
    "barchart": _draw_bars,
}


def _over_time(target: Target, view: View) -> list[Series]:
    return query_range(
        view.prometheus,
        target.filled(view.variables),
        start_s=view.start_s,
        end_s=view.end_s,
        step_s=view.step_s,
    )


def _name(target: Target, series: Series) -> str:
    return re.sub(r"\{\{(\w+)\}\}", lambda m: series.labels.get(m[1], ""), target.legend)


def _own_colour(panel: ReadPanel, series: str) -> str | None:
    for override in panel.raw["fieldConfig"]["overrides"]:
        if override["matcher"]["options"] == series:
            return str(override["properties"][0]["value"]["fixedColor"])
    return None


def _unit(panel: ReadPanel) -> str:
    return str(panel.raw["fieldConfig"]["defaults"]["unit"])


def _write_axes(axes: Axes, unit: str) -> None:
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: written(value, unit)))
    axes.xaxis.set_major_locator(
        dates.AutoDateLocator(maxticks=7, tz=UTC)  # type: ignore[no-untyped-call]
    )
    axes.xaxis.set_major_formatter(FuncFormatter(_clock))
    axes.grid(color=FAINT, linewidth=0.5)


def _say_nothing(axes: Axes) -> None:
    axes.text(0.5, 0.5, "no data", color=FAINT, ha="center", va="center", transform=axes.transAxes)


def _shortened(text: str, *, most: int = 34) -> str:
    return text if len(text) <= most else f"…{text[-most:]}"


def _clock(day: float, _: object) -> str:
    return datetime.fromtimestamp(day * DAY_S, tz=UTC).strftime("%H:%M")


def main() -> None:
    """Draw both dashboards, up to now.

    Raises:
        SystemExit: With 1 and one sentence, if an address does not answer or a file cannot be
            written.
    """
    mpl.use("agg")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--prometheus", default="127.0.0.1:9090", help="host:port")
    parser.add_argument("--service", default="127.0.0.1:9464", help="host:port")
    parser.add_argument("--minutes", type=float, default=60.0, help="How far back.")
    parser.add_argument("--rate-interval", default="1m", help="What $__rate_interval becomes.")
    parser.add_argument("--out", type=Path, default=Path(), help="Folder for the pictures.")
    asked = parser.parse_args()
    try:
        asked.out.mkdir(parents=True, exist_ok=True)
        _draw_all(asked)
    except AnswerError as error:
        parser.exit(1, f"error: {error}; check --prometheus and --service, and that both run\n")
    except OSError as error:
        parser.exit(1, f"error: cannot write pictures to {asked.out}: {error}\n")


def _draw_all(asked: argparse.Namespace) -> None:
    end_s = time.clock_gettime(time.CLOCK_REALTIME)
    for path in sorted(FOLDER.glob("*.json")):
        variables = variables_of(
            path, rate_interval=asked.rate_interval, time_range=f"{round(asked.minutes * 60)}s"
        )
        view = View(asked.prometheus, asked.service, end_s - asked.minutes * 60, end_s, variables)
        draw(path, view, asked.out / f"{path.stem}.png")


if __name__ == "__main__":
    main()
