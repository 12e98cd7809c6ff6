"""What dashboards and alerts ask for exists, and what exists is asked for."""

import json
import re
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
import yaml
from prometheus_client import CollectorRegistry
from prometheus_client.core import Metric

from deploy.grafana.make_dashboards import made
from deploy.grafana.panels import COLUMNS, PROMETHEUS, RATES
from service.curation.rates import RateRow, rates_request
from service.monitoring.gauges import ServiceGauges, Sources
from service.monitoring.metrics import ServiceMetrics
from tests.dashboard_reading import ReadPanel, metrics_in, read_dashboard
from workers.worker.metrics import PoolMetrics, WorkerMetrics

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
DASHBOARDS = sorted((DEPLOY / "grafana" / "dashboards").glob("*.json"))
RULES = DEPLOY / "prometheus" / "rules" / "counterpoint.yml"

NOT_SHOWN: dict[str, str] = {}
"""Metrics that no panel and no alert shows, and why."""

PANEL_TYPES = {"timeseries", "stat", "heatmap", "barchart"}
"""Those of Grafana that are drawn; its `graph`, `singlestat` and `table-old` are gone."""


def families() -> list[Metric]:
    service, workers = ServiceMetrics(vehicles=["car-7"]).registry, CollectorRegistry()
    WorkerMetrics(workers)
    PoolMetrics(workers)
    gauges = ServiceGauges(Sources(state_free_bytes=lambda: 1))
    return [*service.collect(), *gauges.collect(), *workers.collect()]


def series_names(family: Metric) -> set[str]:
    endings = {"counter": ("_total",), "histogram": ("_bucket", "_sum", "_count")}
    return {family.name + ending for ending in endings.get(family.type, ("",))}


def panels() -> list[ReadPanel]:
    return list(chain.from_iterable(read_dashboard(path) for path in DASHBOARDS))


def rules() -> list[dict[str, Any]]:
    groups = yaml.safe_load(RULES.read_text(encoding="utf-8"))["groups"]
    return [rule for group in groups for rule in group["rules"]]


def expressions() -> dict[str, str]:
    asked = {
        f"panel {panel.title!r}, {number}": target.text
        for panel in panels()
        for number, target in enumerate(panel.targets)
        if target.kind == "promql"
    }
    return asked | {
        f"rule {rule.get('alert', rule.get('record'))}": rule["expr"] for rule in rules()
    }


def selectors(expr: str) -> Iterator[tuple[str, str, str, str]]:
    """Yield metric, label, operator and value of every matcher on a metric of ours."""
    for metric, matchers in re.findall(r"\b(counterpoint_\w+)\{([^}]*)\}", expr):
        for label, operator, value in re.findall(r'(\w+)(=~|!=|=)"([^"]*)"', matchers):
            yield metric, label, operator, value


def test_the_files_are_what_the_code_makes() -> None:
    for path, text in made().items():
        assert path.read_text(encoding="utf-8") == text, (
            f"{path.name} lags: run python -m deploy.grafana.make_dashboards"
        )
    assert set(made()) == set(DASHBOARDS)


@pytest.mark.parametrize(("where", "expr"), expressions().items())
def test_every_expression_reads_metrics_that_exist(where: str, expr: str) -> None:
    known = set[str]().union(*(series_names(family) for family in families()))
    assert metrics_in(expr) - known == set(), where


@pytest.mark.parametrize(("where", "expr"), expressions().items())
def test_every_expression_selects_label_values_that_exist(where: str, expr: str) -> None:
    known: dict[tuple[str, str], set[str]] = {}
    for sample in chain.from_iterable(family.samples for family in families()):
        for label, value in sample.labels.items():
            known.setdefault((sample.name, label), set()).add(value)
    for metric, label, operator, value in selectors(expr):
        values = known[metric, label]
        if operator == "=~" and not value.startswith("$"):
            assert [v for v in values if re.fullmatch(value, v)], (where, metric, label, value)
        elif operator != "=~":
            assert value in values, (where, metric, label, value)


def test_every_metric_is_shown_or_watched_or_left_out_on_purpose() -> None:
    asked = set[str]().union(*(metrics_in(expr) for expr in expressions().values()))
    unseen = {family.name for family in families() if not series_names(family) & asked}
    assert unseen == set(NOT_SHOWN)


@pytest.mark.parametrize("panel", panels(), ids=lambda panel: panel.title)
def test_every_panel_says_what_it_shows_and_in_which_unit(panel: ReadPanel) -> None:
    assert panel.title
    assert len(panel.raw["description"]) > 20
    assert panel.raw["fieldConfig"]["defaults"]["unit"]
    assert panel.kind in PANEL_TYPES
    assert panel.targets
    for target in panel.targets:
        assert "[5m]" not in target.text, "a fixed window hides or invents data at other zooms"


@pytest.mark.parametrize("panel", panels(), ids=lambda panel: panel.title)
def test_every_panel_names_a_provisioned_data_source(panel: ReadPanel) -> None:
    provisioned = yaml.safe_load(
        (DEPLOY / "grafana" / "provisioning" / "datasources" / "counterpoint.yaml").read_text()
    )["datasources"]
    sources = [{"type": source["type"], "uid": source["uid"]} for source in provisioned]
    assert sources == [PROMETHEUS, RATES]
    assert panel.raw["datasource"] in sources
    assert all(target["datasource"] == panel.raw["datasource"] for target in panel.raw["targets"])


@pytest.mark.parametrize("panel", panels(), ids=lambda panel: panel.title)
def test_every_question_to_the_store_is_one_that_it_answers(panel: ReadPanel) -> None:
    for target in panel.targets:
        if target.kind == "path":
            by = re.match(r"/rates\?by=(\w+)&since=\$recorded$", target.text)
            assert by is not None
            rates_request(by[1], since="1970-01-01", now_s=0.0)
            assert set(target.values) <= set(RateRow.model_fields)


@pytest.mark.parametrize("path", DASHBOARDS, ids=lambda path: path.stem)
def test_panels_lie_side_by_side_and_have_numbers_of_their_own(path: Path) -> None:
    dashboard = json.loads(path.read_text(encoding="utf-8"))
    taken: set[tuple[int, int]] = set()
    for panel in dashboard["panels"]:
        place = panel["gridPos"]
        cells = {
            (x, y)
            for x in range(place["x"], place["x"] + place["w"])
            for y in range(place["y"], place["y"] + place["h"])
        }
        assert max(x for x, _ in cells) < COLUMNS
        assert not taken & cells, panel["title"]
        taken |= cells
    ids = [panel["id"] for panel in dashboard["panels"]]
    assert len(set(ids)) == len(ids)
    assert dashboard["uid"].startswith("counterpoint-")


def test_every_alert_says_what_is_wrong_and_what_to_do() -> None:
    manual = (DEPLOY / "README.md").read_text(encoding="utf-8")
    headings = {line.lstrip("# ").lower() for line in manual.splitlines() if line.startswith("###")}
    for rule in rules():
        if "alert" not in rule:
            continue
        name, said = rule["alert"], rule["annotations"]
        assert rule["labels"]["severity"] in {"critical", "warning", "info"}, name
        assert said["summary"].endswith("."), name
        assert said["description"].endswith("."), name
        place = f"deploy/README.md#{name.lower()}"
        assert said["runbook_url"] == "{{ $externalLabels.runbooks }}" + place
        assert name.lower() in headings, f"the runbook says nothing of {name}"


def test_every_alert_is_tested_to_fire_and_to_be_quiet() -> None:
    files = (DEPLOY / "prometheus" / "tests").glob("*.yml")
    tests = [test for file in files for test in yaml.safe_load(file.read_text())["tests"]]
    alerts = {rule["alert"] for rule in rules() if "alert" in rule}
    for word, fires in (("fires", True), ("is quiet", False)):
        found = {
            test["name"].split()[0]
            for test in tests
            if f" {word} " in test["name"]
            and all(bool(check["exp_samples"]) is fires for check in test["promql_expr_test"])
        }
        assert found == alerts
