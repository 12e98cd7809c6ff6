"""Model of a dashboard, and its conversion to Grafana's JSON."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

PROMETHEUS: Final = {"type": "prometheus", "uid": "counterpoint-prometheus"}
RATES: Final = {"type": "yesoreyeram-infinity-datasource", "uid": "counterpoint-rates"}
"""Data sources by the uids that `provisioning/datasources` defines."""

SCHEMA_VERSION: Final = 41
"""Version of the dashboard JSON: Grafana 12 reads it directly, later ones migrate it on load."""

COLUMNS: Final = 24
"""Width of a dashboard in Grafana's own grid."""

Kind = Literal["timeseries", "stat", "heatmap", "barchart"]

GREEN, YELLOW, RED = "green", "yellow", "red"
Thresholds = Sequence[tuple[float, str]]
"""Colours by lower bound of the value; below the first one, green."""


@dataclass(frozen=True, slots=True)
class Query:
    """One PromQL expression, and the legend of its series."""

    expr: str
    legend: str = ""


@dataclass(frozen=True, slots=True)
class Ask:
    """One request to `/rates` of the service, drawn as bars.

    Attributes:
        by: Grouping of the scenes, one bar each.
        values: Fields of a row that are drawn, stacked.
        most: Number of bars at most; the service sorts worst first.
    """

    by: str
    values: tuple[str, ...]
    most: int = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One panel.

    Attributes:
        title: Title.
        description: Interpretation, and values that need attention.
        unit: Unit id of Grafana.
        kind: Type of visualization.
        queries: Queries to Prometheus.
        ask: Request to the store of the service.
        width: In columns of Grafana's grid.
        height: In rows of it.
        thresholds: Colours by value; a line over time, the colour of a number.
        most: End of the axis, where it is known.
        stacked: True if the series add up to a total.
        decimals: Digits after the point; None: Grafana chooses.
        colours: Series name to colour, where a colour has a meaning.
    """

    title: str
    description: str
    unit: str
    kind: Kind = "timeseries"
    queries: Sequence[Query] = ()
    ask: Ask | None = None
    width: int = 8
    height: int = 8
    thresholds: Thresholds = ()
    most: float | None = None
    stacked: bool = False
    decimals: int | None = None
    colours: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Row:
    """Panels under a heading, from left to right."""

    title: str
    panels: Sequence[Panel]


@dataclass(frozen=True, slots=True, kw_only=True)
class Dashboard:
    """One dashboard.

    Attributes:
        uid: Fixed, so that links survive.
        title: Its name in Grafana.
        description: Its purpose.
        rows: From top to bottom.
        since: Start of the initial time range.
        refresh: Interval of refreshes.
        variables: Names to label queries, offered above the panels.
        choices: Names to options, as text and value; the first is the default.
    """

    uid: str
    title: str
    description: str
    rows: Sequence[Row]
    since: str
    refresh: str = "30s"
    variables: dict[str, str] = field(default_factory=dict)
    choices: dict[str, Sequence[tuple[str, str]]] = field(default_factory=dict)


def dashboard_json(dashboard: Dashboard) -> dict[str, Any]:
    """Return the JSON that Grafana is provisioned with."""
    return {
        "uid": dashboard.uid,
        "title": dashboard.title,
        "description": dashboard.description,
        "tags": ["counterpoint"],
        "schemaVersion": SCHEMA_VERSION,
        "version": 1,
        "editable": True,
        "graphTooltip": 1,
        "refresh": dashboard.refresh,
        "time": {"from": dashboard.since, "to": "now"},
        "timezone": "browser",
        "annotations": {"list": [_alerts()]},
        "links": [_link_to_the_others()],
        "templating": {
            "list": [_variable(*item) for item in dashboard.variables.items()]
            + [_choice(*item) for item in dashboard.choices.items()]
        },
        "panels": _laid_out(dashboard.rows),
    }


def _laid_out(rows: Sequence[Row]) -> list[dict[str, Any]]:
    made: list[dict[str, Any]] = []
    y = 0
    for row in rows:
        made.append(
            {
                "id": len(made) + 1,
                "type": "row",
                "title": row.title,
                "collapsed": False,
                "gridPos": {"x": 0, "y": y, "w": COLUMNS, "h": 1},
                "panels": [],
            }
        )
        y += 1
        x = tallest = 0
        for panel in row.panels:
            if x + panel.width > COLUMNS:
                x, y, tallest = 0, y + tallest, 0
            place = {"x": x, "y": y, "w": panel.width, "h": panel.height}
            made.append({"id": len(made) + 1, "gridPos": place, **_panel_json(panel)})
            x, tallest = x + panel.width, max(tallest, panel.height)
        y += tallest
    return made


def _panel_json(panel: Panel) -> dict[str, Any]:
    defaults: dict[str, Any] = {
        "unit": panel.unit,
        "min": 0,
        "color": {"mode": "palette-classic" if panel.kind != "stat" else "thresholds"},
        "thresholds": {"mode": "absolute", "steps": _steps(panel.thresholds)},
        "custom": _CUSTOM[panel.kind] | _drawn(panel),
        "noValue": "no data",
    }
    if panel.most is not None:
        defaults["max"] = panel.most
    if panel.decimals is not None:
        defaults["decimals"] = panel.decimals
    return {
        "type": panel.kind,
        "title": panel.title,
        "description": panel.description,
        "datasource": PROMETHEUS if panel.ask is None else RATES,
        "targets": _targets(panel),
        "fieldConfig": {
            "defaults": defaults,
            "overrides": [_painted(name, colour) for name, colour in panel.colours.items()],
        },
        "options": _OPTIONS[panel.kind],
        "transformations": [] if panel.ask is None else [_limited(panel.ask.most)],
    }


def _targets(panel: Panel) -> list[dict[str, Any]]:
    if panel.ask is not None:
        return [_asked(panel.ask)]
    return [
        {
            "refId": chr(ord("A") + number),
            "datasource": PROMETHEUS,
            "expr": query.expr,
            "legendFormat": query.legend or "__auto",
            "format": "heatmap" if panel.kind == "heatmap" else "time_series",
            "instant": panel.kind == "stat",
            "range": panel.kind != "stat",
        }
        for number, query in enumerate(panel.queries)
    ]


def _asked(ask: Ask) -> dict[str, Any]:
    columns = [{"selector": "group", "text": "group", "type": "string"}]
    columns += [{"selector": value, "text": value, "type": "number"} for value in ask.values]
    return {
        "refId": "A",
        "datasource": RATES,
        "type": "json",
        "parser": "backend",
        "source": "url",
        "format": "table",
        "url": f"/rates?by={ask.by}&since=$recorded",
        "url_options": {"method": "GET"},
        "root_selector": "",
        "columns": columns,
        "filters": [],
    }


def _drawn(panel: Panel) -> dict[str, Any]:
    if panel.kind != "timeseries":
        return {}
    drawn: dict[str, Any] = {"thresholdsStyle": {"mode": "line" if panel.thresholds else "off"}}
    if panel.stacked:
        drawn |= {"fillOpacity": 60, "stacking": {"mode": "normal", "group": "A"}}
    return drawn


def _steps(thresholds: Thresholds) -> list[dict[str, Any]]:
    return [{"color": GREEN, "value": None}] + [
        {"color": colour, "value": value} for value, colour in thresholds
    ]


def _limited(rows: int) -> dict[str, Any]:
    return {"id": "limit", "options": {"limitField": rows}}


def _painted(series: str, colour: str) -> dict[str, Any]:
    return {
        "matcher": {"id": "byName", "options": series},
        "properties": [{"id": "color", "value": {"mode": "fixed", "fixedColor": colour}}],
    }


def _variable(name: str, query: str) -> dict[str, Any]:
    return {
        "type": "query",
        "name": name,
        "label": name,
        "datasource": PROMETHEUS,
        "query": {"query": query, "refId": name},
        "definition": query,
        "refresh": 2,
        "sort": 1,
        "multi": True,
        "includeAll": True,
        "allValue": ".*",
        "current": {"text": ["All"], "value": ["$__all"]},
    }


def _choice(name: str, values: Sequence[tuple[str, str]]) -> dict[str, Any]:
    options = [
        {"text": text, "value": value, "selected": number == 0}
        for number, (text, value) in enumerate(values)
    ]
    return {
        "type": "custom",
        "name": name,
        "label": name,
        "query": ", ".join(f"{text} : {value}" for text, value in values),
        "options": options,
        "current": options[0],
        "multi": False,
        "includeAll": False,
    }


def _alerts() -> dict[str, Any]:
    return {
        "name": "Alerts",
        "datasource": PROMETHEUS,
        "enable": True,
        "iconColor": RED,
        "expr": 'ALERTS{alertname=~"Counterpoint.+", alertstate="firing"}',
        "titleFormat": "{{alertname}}",
        "step": "60s",
    }


def _link_to_the_others() -> dict[str, Any]:
    return {
        "type": "dashboards",
        "title": "Counterpoint",
        "tags": ["counterpoint"],
        "keepTime": True,
        "includeVars": True,
        "asDropdown": False,
        "targetBlank": False,
        "icon": "external link",
        "tooltip": "",
        "url": "",
    }


_CUSTOM: Final[dict[Kind, dict[str, Any]]] = {
    "timeseries": {
        "drawStyle": "line",
        "lineWidth": 1,
        "fillOpacity": 10,
        "showPoints": "never",
        "spanNulls": 120_000,
    },
    "stat": {},
    "heatmap": {},
    "barchart": {"fillOpacity": 80, "lineWidth": 1},
}

_OPTIONS: Final[dict[Kind, dict[str, Any]]] = {
    "timeseries": {
        "legend": {"displayMode": "list", "placement": "bottom", "showLegend": True},
        "tooltip": {"mode": "multi", "sort": "desc"},
    },
    "stat": {
        "colorMode": "background",
        "graphMode": "none",
        "justifyMode": "center",
        "orientation": "auto",
        "textMode": "auto",
        "reduceOptions": {"calcs": ["lastNotNull"], "fields": "", "values": False},
    },
    "heatmap": {
        "calculate": False,
        "color": {"mode": "scheme", "scheme": "Oranges", "steps": 64},
        "cellGap": 1,
        "filterValues": {"le": 1e-9},
        "rowsFrame": {"layout": "auto"},
        "tooltip": {"mode": "single"},
        "yAxis": {"axisPlacement": "left"},
        "legend": {"show": True},
    },
    "barchart": {
        "xField": "group",
        "orientation": "auto",
        "stacking": "normal",
        "showValue": "auto",
        "xTickLabelMaxLength": 24,
        "legend": {"displayMode": "list", "placement": "bottom", "showLegend": True},
        "tooltip": {"mode": "single"},
    },
}
