"""Reader of a dashboard file: its panels, and their queries with variables filled in."""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

FOLDER: Final = Path(__file__).resolve().parents[1] / "deploy" / "grafana" / "dashboards"


@dataclass(frozen=True, slots=True)
class Target:
    """One query of a panel, variables not filled in.

    Attributes:
        kind: PromQL for Prometheus, or a path of the service's own HTTP endpoint.
        text: Expression, or path with parameters.
        legend: Pattern of the names of its series.
        values: Fields of a row that are drawn; for a path only.
    """

    kind: Literal["promql", "path"]
    text: str
    legend: str = ""
    values: tuple[str, ...] = ()

    def filled(self, variables: Mapping[str, str]) -> str:
        """Return the text with every variable replaced.

        Raises:
            KeyError: If a variable has no value.
        """
        return _VARIABLE.sub(lambda found: variables[found["braced"] or found["bare"]], self.text)


@dataclass(frozen=True, slots=True)
class ReadPanel:
    """One panel of a dashboard's file, headings left out; `raw` is its whole JSON."""

    title: str
    kind: str
    targets: tuple[Target, ...]
    raw: Mapping[str, Any]


def read_dashboard(path: Path) -> list[ReadPanel]:
    """Read the panels of one file, from top to bottom."""
    dashboard = json.loads(path.read_text(encoding="utf-8"))
    return [
        ReadPanel(raw["title"], raw["type"], tuple(_targets(raw)), raw)
        for raw in dashboard["panels"]
        if raw["type"] != "row"
    ]


def variables_of(path: Path, *, rate_interval: str, time_range: str) -> dict[str, str]:
    """Return every variable of a dashboard with its initial value.

    Args:
        path: Path of the dashboard.
        rate_interval: Interval that Grafana derives from the scrape interval and the picture's
            width.
        time_range: Time range of the whole picture.
    """
    variables = {"__rate_interval": rate_interval, "__range": time_range}
    for variable in json.loads(path.read_text(encoding="utf-8"))["templating"]["list"]:
        chosen = variable["current"]["value"]
        variables[variable["name"]] = variable["allValue"] if chosen == ["$__all"] else str(chosen)
    return variables


def metrics_in(expr: str) -> set[str]:
    """Return the metrics of Counterpoint in a PromQL expression."""
    return set(_METRIC.findall(expr))


def _targets(raw: Mapping[str, Any]) -> Iterator[Target]:
    for target in raw["targets"]:
        if "expr" in target:
            yield Target("promql", target["expr"], target["legendFormat"])
        else:
            columns = tuple(c["selector"] for c in target["columns"] if c["type"] == "number")
            yield Target("path", target["url"], values=columns)


_VARIABLE: Final = re.compile(r"\$(?:\{(?P<braced>\w+)\}|(?P<bare>\w+))")
_METRIC: Final = re.compile(r"\bcounterpoint_[a-z0-9_]+")
