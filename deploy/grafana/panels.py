"""What a dashboard is made of, and the JSON that Grafana makes of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

PROMETHEUS: Final = {"type": "prometheus", "uid": "counterpoint-prometheus"}
RATES: Final = {"type": "yesoreyeram-infinity-datasource", "uid": "counterpoint-rates"}
"""Data sources by the uids that `provisioning/datasources` gives them."""

SCHEMA_VERSION: Final = 41
"""Of dashboard JSON: Grafana 12 reads it as it is, later ones migrate it when they load it."""

COLUMNS: Final = 24
"""Width of a dashboard in Grafana's own grid."""

Kind = Literal["timeseries", "stat", "heatmap", "barchart"]

GREEN, YELLOW, RED = "green", "yellow", "red"
Thresholds = Sequence[tuple[float, str]]
"""From this value on, this colour; below the first one, green."""


@dataclass(frozen=True, slots=True)
class Query:
    """One PromQL expression, and how its series are called."""

    expr: str
    legend: str = ""


@dataclass(frozen=True, slots=True)
class Ask:
    """One question to `/rates` of the service, drawn as bars.

    Attributes:
        by: What the scenes are grouped by: one bar each.
        values: Fields of a row that are drawn, one on the other.
        most: Bars at most; the service sorts worst first.
    """

    by: str
    values: tuple[str, ...]
    most: int = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One picture.

    Attributes:
        title: What it shows.
        description: What to read from it, and when to worry.
        unit: Unit id of Grafana.
        kind: How it is drawn.
        queries: What it draws, from Prometheus.
        ask: What it draws, from the store of the service.
        width: In columns of Grafana's grid.
        height: In rows of it.
        thresholds: Colours by value; a line over time, the colour of a number.
        most: End of the axis, where it is known.
        stacked: Whether series add up to something.
        decimals: Digits after the point; None: Grafana chooses.
        colours: Series name to colour, where a colour means something.
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
    """Panels under a heading, laid out from left to right."""

    title: str
    panels: Sequence[Panel]


@dataclass(frozen=True, slots=True, kw_only=True)
class Dashboard:
    """One page.

    Attributes:
        uid: Fixed, so that links survive.
        title: Its name in Grafana.
        description: What it is for.
        rows: From top to bottom.
        since: Start of the time range that it opens with.
        refresh: How often it looks again.
        variables: Names to label queries, offered above the panels.
        choices: Names to what each may be, as text and value; the first holds.
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
    """Make the JSON that Grafana is provisioned with."""
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
