"""The system of `deploy/compose.yaml`, built and run by a container engine."""

import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any, Final, Self
from uuid import uuid4

from tests.free_ports import free_port

DEPLOY: Final = Path(__file__).resolve().parents[2] / "deploy"
PARTS: Final = ("router", "service", "worker", "review")
"""Services of our own images; Prometheus and Grafana are images of others."""

DEADLINE_S: Final = 600.0


def missing() -> str:
    """Return what this machine lacks to run compose.yaml; empty: nothing."""
    if shutil.which("docker") is None:
        return "needs docker"
    for command in (["docker", "info"], ["docker", "compose", "version"]):
        if subprocess.run(command, capture_output=True, check=False).returncode:
            return f"needs a container engine that answers `{' '.join(command)}`"
    return ""


class Composed:
    """Containers of a project of their own, for as long as the `with` block lasts.

    Attributes:
        logs: Folder that they see as their bucket.
        review_url: Address of the review page.
    """

    def __init__(self, folder: Path) -> None:
        """Write the settings that an operator writes into `.env`.

        Args:
            folder: Place of the settings and of the bucket; every user can read it.
        """
        self.logs = folder / "logs"
        self.logs.mkdir()
        ports = {name: f"127.0.0.1:{free_port()}" for name in ("ROUTER", "SERVICE", "REVIEW")}
        self.review_url = f"http://{ports['REVIEW']}/"
        settings = {
            "COMPOSE_FILE": f"{DEPLOY / 'compose.yaml'}:{DEPLOY / 'compose.folder.yaml'}",
            "COMPOSE_PROJECT_NAME": f"counterpoint-{uuid4().hex[:8]}",
            "BUCKET": "file:///logs",
            "LOGS_DIR": str(self.logs),
            "GRAFANA_PASSWORD": "not started here",
            "WORKERS": "1",
            "TAG": "tested",
            **{f"{name}_PORT": port for name, port in ports.items()},
        }
        self._env = os.environ | settings

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.compose("down", "--volumes", "--timeout", "60")

    def compose(self, *arguments: str) -> str:
        """Run `docker compose` and return what it printed.

        Raises:
            AssertionError: If it fails; with all that the containers said.
        """
        done = self._run(*arguments)
        if done.returncode:
            said = self._run("logs", "--no-color", "--tail", "40").stdout
            raise AssertionError(f"{' '.join(arguments)}: {done.stdout}{done.stderr}\n{said}")
        return done.stdout

    def start(self) -> None:
        """Start what does not run, and wait until all of it is healthy."""
        self.compose("up", "--detach", "--no-build", "--wait", *PARTS)

    def kill(self, *names: str) -> None:
        """Kill the containers of these services without a warning."""
        self.compose("kill", "--signal", "SIGKILL", *names)

    def ask(self, *arguments: str) -> list[dict[str, Any]]:
        """Run a command of counterpoint beside the service, and return its lines of JSON."""
        said = self.compose("exec", "--no-TTY", "service", "counterpoint", *arguments, "--json")
        return [json.loads(line) for line in said.splitlines()]

    def records(self) -> dict[str, str]:
        """Return the digest of each scene's record."""
        return {row["scene_id"]: row["sha256"] for row in self.ask("top")}

    def mined(self, logs: int) -> dict[str, str]:
        """Wait until so many logs are mined, and return the digest of each scene's record."""
        end_s = time.monotonic() + DEADLINE_S
        while time.monotonic() < end_s:
            [status] = self.ask("status")
            if [log["state"] for log in status["logs"]] == ["done"] * logs:
                return self.records()
            time.sleep(1.0)
        raise AssertionError(f"not mined within {DEADLINE_S} s: {self.compose('logs')}")

    def _run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        command = ("docker", "compose", *arguments)
        return subprocess.run(command, env=self._env, capture_output=True, text=True, check=False)
