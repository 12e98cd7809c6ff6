"""A Prometheus of a test's own: started on a free port, asked, stopped."""

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

import pytest
import yaml

from tests.free_ports import free_port
from tests.integration.prometheus_asking import AnswerError, get

PROMETHEUS_DEADLINE_S: Final = 120.0
DEPLOY: Final = Path(__file__).resolve().parents[2] / "deploy"
RULES: Final = DEPLOY / "prometheus" / "rules" / "counterpoint.yml"


def need_prometheus() -> None:
    """Fail in CI, skip elsewhere, where Prometheus is not installed."""
    missing = [name for name in ("prometheus", "promtool") if shutil.which(name) is None]
    if missing:
        message = f"{', '.join(missing)} not on PATH: apt-get install prometheus"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)


def until(what: str, met: Callable[[], Any], *, deadline_s: float = PROMETHEUS_DEADLINE_S) -> Any:
    """Wait until something true comes back, and return it."""
    end_s = time.monotonic() + deadline_s
    while time.monotonic() < end_s:
        if found := met():
            return found
        time.sleep(0.2)
    pytest.fail(f"not within {deadline_s:.0f} s: {what}")


def rules_at_once(folder: Path) -> Path:
    """Write a copy of the rules in which no alert waits before it fires."""
    rules = yaml.safe_load(RULES.read_text(encoding="utf-8"))
    for group in rules["groups"]:
        for rule in group["rules"]:
            rule.pop("for", None)
    path = folder / "rules.yml"
    path.write_text(yaml.safe_dump(rules, sort_keys=False), encoding="utf-8")
    return path


class PrometheusServer:
    """Scrapes every second, evaluates every second, runs within a `with` block."""

    def __init__(
        self,
        folder: Path,
        *,
        targets: Mapping[str, Sequence[str]] | None = None,
        rules: Path | None = None,
    ) -> None:
        """Write its configuration.

        Args:
            folder: For it and its blocks, which may lie in `data` already.
            targets: Job to addresses.
            rules: File of rules, if any.
        """
        config = {
            "global": {
                "scrape_interval": "1s",
                "scrape_timeout": "1s",
                "evaluation_interval": "1s",
            },
            "rule_files": [str(rules)] if rules else [],
            "scrape_configs": [
                {"job_name": job, "static_configs": [{"targets": list(addresses)}]}
                for job, addresses in (targets or {}).items()
            ],
        }
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        (folder / "prometheus.yml").write_text(yaml.safe_dump(config), encoding="utf-8")
        self.address = f"127.0.0.1:{free_port()}"
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        with (self._folder / "prometheus.log").open("wb") as log:
            self._process = subprocess.Popen(
                [
                    "prometheus",
                    f"--config.file={self._folder / 'prometheus.yml'}",
                    f"--storage.tsdb.path={self._folder / 'data'}",
                    f"--web.listen-address={self.address}",
                ],
                stdout=log,
                stderr=log,
            )
        until("Prometheus is ready", self._is_ready)
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process is not None
        self._process.terminate()
        self._process.wait(timeout=60)

    def firing(self) -> dict[str, dict[str, Any]]:
        """Return every alert that fires now, by its name."""
        alerts = json.loads(get(self.address, "/api/v1/alerts"))["data"]["alerts"]
        return {a["labels"]["alertname"]: a for a in alerts if a["state"] == "firing"}

    def until_firing(self, alert: str) -> dict[str, Any]:
        """Wait until an alert of this name fires."""
        found: dict[str, Any] = until(f"{alert} fires", lambda: self.firing().get(alert))
        return found

    def rules_with_errors(self) -> list[str]:
        """Name the rules that could not be evaluated."""
        groups = json.loads(get(self.address, "/api/v1/rules"))["data"]["groups"]
        return [r["name"] for group in groups for r in group["rules"] if r["health"] == "err"]

    def _is_ready(self) -> bool:
        assert self._process is not None
        if self._process.poll() is not None:
            pytest.fail((self._folder / "prometheus.log").read_text()[-2000:])
        try:
            get(self.address, "/-/ready")
        except (OSError, AnswerError):
            return False
        return True
