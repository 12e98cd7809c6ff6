"""Every alert, given the series of its own unit test, fires in a real Prometheus, alone."""

import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from service.cli.main import main
from tests.integration.prometheus_server import (
    DEPLOY,
    PrometheusServer,
    need_prometheus,
    rules_at_once,
    until,
)

pytestmark = [pytest.mark.integration]

TESTS = sorted((DEPLOY / "prometheus" / "tests").glob("*.yml"))
SECONDS = {"m": 60, "h": 3600}


def seconds(text: str) -> int:
    return int(text[:-1]) * SECONDS[text[-1]]


def worlds() -> dict[str, dict[str, Any]]:
    """Return the unit tests in which an alert fires, by their names, which begin with its own."""
    return {
        test["name"]: test
        for path in TESTS
        for test in yaml.safe_load(path.read_text(encoding="utf-8"))["tests"]
        if " fires " in test["name"]
    }


def expanded(values: str) -> list[float | None]:
    """Write out promtool's notation: `1x3`, `0+5x10`, `_x2`, `stale`, plain numbers."""
    found: list[float | None] = []
    for word in str(values).split():
        many = re.fullmatch(r"(_|-?[\d.e]+?)(?:([+-])([\d.e]+))?x(\d+)", word)
        if many is None:
            found.append(None if word in ("_", "stale") else float(word))
        else:
            first, sign, step, times = many.groups()
            by = float(step or 0) * (-1 if sign == "-" else 1)
            found += [
                None if first == "_" else float(first) + by * number
                for number in range(int(times) + 1)
            ]
    return found


def open_metrics(test: dict[str, Any], *, now_s: float) -> Iterator[str]:
    """Write a unit test's series as history, the moment at which it fires being now.

    Nothing later: a Prometheus takes no sample of its own that is older than its blocks.
    """
    step_s = seconds(test["interval"])
    fires_s = seconds(test["promql_expr_test"][-1]["eval_time"])
    for series in sorted(test["input_series"], key=lambda one: str(one["series"])):
        name = str(series["series"]).replace(", ", ",")
        for number, value in enumerate(expanded(series["values"])):
            if value is not None and number * step_s <= fires_s:
                yield f"{name} {value} {now_s - fires_s + number * step_s:.3f}"
    yield "# EOF"


@pytest.fixture(scope="module", autouse=True)
def prometheus_is_there() -> None:
    need_prometheus()


def test_the_rules_and_both_configurations_are_valid() -> None:
    folder = DEPLOY / "prometheus"
    subprocess.run(["promtool", "check", "rules", "rules/counterpoint.yml"], cwd=folder, check=True)
    for config in ("prometheus.yml", "one-machine.yml"):
        subprocess.run(["promtool", "check", "config", config], cwd=folder, check=True)


def test_the_locked_configuration_of_the_runbook_is_valid(tmp_path: Path) -> None:
    runbook = (DEPLOY / "README.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"```yaml\n(scrape_configs:\n.*?)```", runbook, re.DOTALL)
    (tmp_path / "prometheus.yml").write_text(shown)
    assert main(["certs", str(tmp_path), "--service", "service"]) == 0
    token = ["token", str(tmp_path / "tokens"), "--name", "prometheus"]
    assert main([*token, "--out", str(tmp_path / "prometheus.token")]) == 0
    subprocess.run(["promtool", "check", "config", "prometheus.yml"], cwd=tmp_path, check=True)


@pytest.mark.parametrize("path", TESTS, ids=lambda path: path.stem)
def test_every_alert_fires_when_it_should_and_is_quiet_when_not(path: Path) -> None:
    subprocess.run(["promtool", "test", "rules", path.name], cwd=path.parent, check=True)


@pytest.mark.parametrize("world", worlds())
def test_in_a_real_prometheus_the_alert_fires_and_says_what_is_wrong(
    world: str, tmp_path: Path
) -> None:
    alert = world.split()[0]
    series = tmp_path / "series.txt"
    series.write_text("\n".join(open_metrics(worlds()[world], now_s=time.time())) + "\n")
    subprocess.run(
        ["promtool", "tsdb", "create-blocks-from", "openmetrics", series, tmp_path / "data"],
        check=True,
        capture_output=True,
    )
    with PrometheusServer(tmp_path, rules=rules_at_once(tmp_path)) as prometheus:
        said = prometheus.until_firing(alert)["annotations"]
        assert prometheus.rules_with_errors() == []
        assert not any("error" in text.split() or "<no value>" in text for text in said.values())
        assert said["runbook_url"] == f"deploy/README.md#{alert.lower()}"
        assert until("it is evaluated again", prometheus.firing)


def test_promtools_notation_is_written_out() -> None:
    assert expanded("1x2 0+5x2 _x1 7 stale 3-1x2") == [
        1, 1, 1, 0, 5, 10, None, None, 7, None, 3, 2, 1,
    ]  # fmt: skip
    assert expanded("50e9-50e6x1") == [50e9, 49.95e9]
