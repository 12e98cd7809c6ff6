"""The processes of the chart's pods, started by hand with their commands, variables and probes."""

import os
import re
import socket
import ssl
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from service.cli.main import main
from tests.chart_rendering import NEEDED, SETS, one, rendered
from tests.free_ports import free_port

pytestmark = pytest.mark.integration

DEADLINE_S = 120.0
PORTS = {"fleet-router": 7447, "fleet-service": 9464, "fleet-worker": 9465, "fleet-review": 8087}


@pytest.fixture
def opened() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def make_locks(tmp_path: Path) -> Path:
    """Write the files of a secret where a kubelet would: behind links, readable by a group."""
    authority, content = str(tmp_path / "authority"), tmp_path / "locks" / "..data"
    parts = ["--router", "router", "--service", "service", "--worker", "worker"]
    assert main(["certs", authority, *parts, "--operator", "review"]) == 0
    content.mkdir(parents=True)
    assert main(["acl", authority, "--out", str(content / "rules.json")]) == 0
    assert main(["token", str(content / "tokens"), "--name", "anna", "--role", "viewer"]) == 0
    for file in Path(authority).iterdir():
        if file.suffix in (".pem", ".key") and file.name != "ca.key":
            (content / file.name).write_bytes(file.read_bytes())
    for file in content.iterdir():
        file.chmod(0o440)
        (content.parent / file.name).symlink_to(Path("..data") / file.name)
    return content.parent


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make the folder of compiled loops, which both sets of pods share."""
    folder = tmp_path_factory.mktemp("cache")
    (folder / "counterpoint").mkdir()
    return folder


@pytest.mark.parametrize("locked", [False, True], ids=["insecure", "locked"])
def test_each_pod_runs_as_the_chart_says_and_answers_its_probes(
    locked: bool, tmp_path: Path, cache: Path, opened: ExitStack
) -> None:
    for folder in ("logs", "overlays", "state"):
        (tmp_path / folder).mkdir()
    places = {
        "bucket": (tmp_path / "logs").as_uri(),
        "artifacts": (tmp_path / "overlays").as_uri(),
    }
    values = SETS["locked"] if locked else NEEDED | {"review": {"enabled": True}}
    manifests = rendered(values | places | {"router": {"replicas": 1}})
    ports = {port: free_port() for port in PORTS.values()}
    moved = {
        "fleet-router-0.fleet-router:": "127.0.0.1:",
        "0.0.0.0:": "127.0.0.1:",
        "/var/lib/counterpoint/state": str(tmp_path / "state"),
        "/var/cache": str(cache),
        "/etc/counterpoint": str(make_locks(tmp_path) if locked else tmp_path),
    }

    def here(text: str) -> str:
        for there, place in moved.items():
            text = text.replace(there, place)
        return re.sub(
            rf"\b({'|'.join(map(str, ports))})\b", lambda port: str(ports[int(port[0])]), text
        )

    for name, port in PORTS.items():
        kind = "StatefulSet" if name == "fleet-router" else "Deployment"
        pod = one(manifests, kind, name)["spec"]["template"]["spec"]
        (container,) = pod["containers"]
        env = {each["name"]: here(each["value"]) for each in container.get("env", ())}
        command = [sys.executable, "-m", "service.cli", *map(here, container["args"])]
        process = subprocess.Popen(command, env=os.environ | env, stderr=subprocess.DEVNULL)
        opened.callback(end, process)
        for probe in ("startupProbe", "livenessProbe"):
            answers(container[probe], ports[port], process)
        if name == "fleet-service":
            answers(container["readinessProbe"], ports[port], process)
    if locked:
        for name in ("fleet-service", "fleet-worker", "fleet-review"):
            path = "/" if name == "fleet-review" else "/metrics"
            with pytest.raises(urllib.error.HTTPError, match="401") as refused:
                ask(f"https://127.0.0.1:{ports[PORTS[name]]}{path}")
            refused.value.close()


def answers(probe: dict[str, Any], port: int, process: Any) -> None:
    """Wait until a probe succeeds as a kubelet would ask it."""
    end_s = time.monotonic() + DEADLINE_S
    while True:
        assert process.poll() is None, process.args
        try:
            if "tcpSocket" in probe:
                socket.create_connection(("127.0.0.1", port), 4).close()
            else:
                get = probe["httpGet"]
                headers = {each["name"]: each["value"] for each in get.get("httpHeaders", ())}
                ask(f"{get['scheme'].lower()}://127.0.0.1:{port}{get['path']}", headers)
            return
        except OSError:
            assert time.monotonic() < end_s, (probe, process.args)
            time.sleep(0.05)


def ask(url: str, headers: dict[str, str] | None = None) -> None:
    """Get a page, without asking who made its certificate."""
    context = ssl.create_default_context() if url.startswith("https") else None
    if context is not None:
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    request = urllib.request.Request(url, headers=headers or {})  # noqa: S310
    with urllib.request.urlopen(request, timeout=4, context=context) as reply:  # noqa: S310
        assert reply.status == 200


def end(process: subprocess.Popen[bytes]) -> None:
    process.kill()  # a worker that compiles takes half a minute to stop
    process.wait(60)
