"""Dockerfile, compose files and units name commands, settings and files that exist."""

import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from schemas.transport.endpoints import is_loopback
from service.cli.main import EX_TEMPFAIL, app_of
from service.settings.config import Settings
from service.worker_pools import accepted_by
from workers.pool.slot import KILL_MARGIN_S
from workers.worker.acceptance import refusal
from workers.worker.config import DRAIN_S, WorkerConfig

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
COMPOSE = yaml.safe_load((DEPLOY / "compose.yaml").read_text(encoding="utf-8"))
OURS = ("router", "service", "worker", "review")


def dockerfile() -> list[tuple[str, str]]:
    """Return instructions and their arguments, continued lines joined, comments left out."""
    text = (DEPLOY / "Dockerfile").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    joined = re.sub(r"\\\n\s*", "", "\n".join(lines)).splitlines()
    return [(line.split(maxsplit=1)[0], line.split(maxsplit=1)[1]) for line in joined]


def stage(name: str) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    inside = False
    for instruction, argument in dockerfile():
        if instruction == "FROM":
            inside = argument.endswith(f" AS {name}")
        if inside:
            found.append((instruction, argument))
    return found


def environment_of(instructions: list[tuple[str, str]]) -> dict[str, str]:
    pairs = [pair for name, text in instructions if name == "ENV" for pair in shlex.split(text)]
    return dict(pair.split("=", 1) for pair in pairs)


def check_command(words: list[str]) -> None:
    """Assert that the command has this verb, and the verb these options."""
    verbs: dict[str, Any] = vars(typer.main.get_command(app_of()))["commands"]
    verb = verbs[words[0]]
    known = {option for param in verb.params for option in (*param.opts, *param.secondary_opts)}
    given = {word for word in words[1:] if word.startswith("--")}
    assert given <= known


def settings_named(text: str) -> set[str]:
    return {name.lower() for name in re.findall(r"\bCOUNTERPOINT_([A-Z_]+)\b(?=[=:])", text)}


def all_settings() -> Iterator[str]:
    yield from Settings.model_fields


@pytest.mark.parametrize("target", ["service", "worker"])
def test_the_images_start_verbs_that_exist_under_a_user_without_rights(target: str) -> None:
    own, runtime = dict(stage(target)), stage("runtime")
    assert json.loads(dict(runtime)["ENTRYPOINT"]) == ["counterpoint"]
    check_command(json.loads(own["CMD"]))
    assert dict(runtime)["USER"] == "10001:10001"
    assert own["FROM"].startswith("runtime ")


@pytest.mark.parametrize(
    ("target", "setting"), [("service", "HTTP_LISTEN"), ("worker", "WORKER_HTTP_LISTEN")]
)
def test_health_is_asked_for_where_the_image_listens(target: str, setting: str) -> None:
    own = stage(target)
    port = environment_of(own)[f"COUNTERPOINT_{setting}"].rpartition(":")[2]
    assert dict(own)["EXPOSE"] == port
    assert f"127.0.0.1:{port}/healthz" in dict(own)["HEALTHCHECK"]


def test_what_is_copied_into_the_build_exists_and_is_sent_to_the_builder() -> None:
    allowed = {
        line[1:]
        for line in (DEPLOY / "Dockerfile.dockerignore").read_text().splitlines()
        if line.startswith("!")
    }
    copied = [
        source.removeprefix("./")
        for name, text in dockerfile()
        if name == "COPY" and "--from" not in text
        for source in text.split()[:-1]
    ]
    assert set(copied) == allowed
    assert all((ROOT / source).exists() for source in copied)


def test_the_image_holds_the_torch_that_the_project_pins() -> None:
    pinned = re.search(r'"torch==([\d.]+)"', (ROOT / "pyproject.toml").read_text())
    built = re.search(r"^ARG TORCH=([\d.]+)$", (DEPLOY / "Dockerfile").read_text(), re.M)
    assert pinned is not None
    assert built is not None
    assert built[1] == pinned[1]


def test_the_service_image_is_built_without_the_workers_extra() -> None:
    installs = [
        text for name, text in stage("build-service") if name == "RUN" and "install" in text
    ]
    assert installs
    assert not any("workers" in text or "torch" in text for text in installs)


@pytest.mark.parametrize("name", OURS)
def test_a_container_of_ours_can_do_little_and_stops_in_time(name: str) -> None:
    service = COMPOSE["services"][name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["restart"] == "unless-stopped"
    assert int(service["stop_grace_period"].removesuffix("s")) > DRAIN_S + KILL_MARGIN_S
    check_command(service["command"])
    target = service["build"]["target"]
    assert stage(target)
    assert (DEPLOY / service["build"]["context"] / service["build"]["dockerfile"]).is_file()


@pytest.mark.parametrize("name", COMPOSE["services"])
def test_ports_are_open_to_this_machine_only(name: str) -> None:
    for port in COMPOSE["services"][name].get("ports", []):
        assert re.match(r"\$\{\w+:-127\.0\.0\.1:\d+\}:\d+$", port), port


@pytest.mark.parametrize("name", COMPOSE["services"])
def test_every_image_is_pinned_or_ours(name: str) -> None:
    image = COMPOSE["services"][name]["image"]
    assert re.search(r":v?\d+\.\d+\.\d+$", image) or "counterpoint-" in image


def test_what_is_mounted_exists_and_every_volume_is_declared() -> None:
    for service in COMPOSE["services"].values():
        for mount in service.get("volumes", []):
            source = mount.split(":")[0]
            exists = (DEPLOY / source).exists() if source.startswith(".") else True
            assert exists, mount
            assert source.startswith(".") or source in COMPOSE["volumes"], mount


def test_every_service_waits_for_others_that_can_be_healthy() -> None:
    images_with_health = {"service", "worker"}
    for service in COMPOSE["services"].values():
        for other, how in service.get("depends_on", {}).items():
            if other == "authority":  # it ends, and is not healthy
                assert how == {"condition": "service_completed_successfully"}
                continue
            assert how == {"condition": "service_healthy"}
            waited = COMPOSE["services"][other]
            built = waited.get("build", {}).get("target")
            assert "healthcheck" in waited or built in images_with_health


def test_a_worker_accepts_the_places_that_the_service_beside_it_names() -> None:
    given = {"BUCKET": "s3://fleet", "ARTIFACTS": "s3://overlays"}

    def settings_of(name: str, env: dict[str, str]) -> Settings:
        stated: dict[str, str] = COMPOSE["services"][name]["environment"]
        words = {
            setting: re.sub(
                r"\$\{(\w+)(?::[-?]([^}]*))?\}", lambda at: env.get(at[1], at[2] or ""), value
            )
            for setting, value in stated.items()
        }
        values = {key.removeprefix("COUNTERPOINT_").lower(): text for key, text in words.items()}
        return Settings.model_validate(values)

    for env in (given, {"BUCKET": "file:///logs"}):
        service, worker = settings_of("service", env), settings_of("worker", env)
        assert service.bucket == env["BUCKET"]
        config = WorkerConfig("w1", (worker.connect,), accepts=accepted_by(worker))
        assert not is_loopback(worker.connect)
        assert refusal(service.mining(), config) == ""


def test_the_examples_name_every_variable_that_must_be_set() -> None:
    text = (DEPLOY / "compose.yaml").read_text() + (DEPLOY / "compose.folder.yaml").read_text()
    example = (DEPLOY / ".env.example").read_text()
    for name in re.findall(r"\$\{(\w+):\?", text):
        assert re.search(rf"^#? ?{name}=", example, re.M), name
    assert "COMPOSE_FILE=compose.yaml:compose.folder.yaml" in example
    for name in set(re.findall(r"^#? ?([A-Z_]+)=", example, re.M)) - {"COMPOSE_FILE"}:
        assert f"${{{name}" in text, f"{name} changes nothing"


@pytest.mark.parametrize(
    "path",
    [
        "Dockerfile",
        "compose.yaml",
        "counterpoint.env.example",
        ".env.example",
        "systemd/counterpoint.service",
        "systemd/counterpoint-review.service",
    ],
)
def test_every_setting_that_is_named_exists(path: str) -> None:
    text = (DEPLOY / path).read_text(encoding="utf-8")
    text = text.replace("COUNTERPOINT_URL:", "")  # Grafana's, for its data source
    known = set(all_settings()) | {"config"}
    assert settings_named(text) <= known


LOCKS = "/var/lib/counterpoint/locks"
UNITS = ("counterpoint.service", "counterpoint-review.service")


def test_compose_makes_an_authority_with_a_certificate_for_each_process() -> None:
    authority = COMPOSE["services"]["authority"]
    certs, acl = (shlex.split(each) for each in authority["command"][0].split(";")[:2])
    check_command(certs[1:])
    check_command(acl[1:])
    copies = authority["command"][0].split(";", 2)[2]
    for name in OURS:
        service = COMPOSE["services"][name]
        (locks,) = [mount for mount in service["volumes"] if "/locks" in mount]
        assert locks == f"{name}-locks:{LOCKS}:ro"
        assert f"{name}-locks:{LOCKS}/{name}" in authority["volumes"]
        assert not any(mount.startswith("authority") for mount in service["volumes"])
        assert service["environment"]["COUNTERPOINT_TLS_CERTIFICATE"] == f"{LOCKS}/{name}.pem"
        assert name in certs
        assert re.search(rf"\b{name}\b", copies)
    assert acl[-1] == f"{LOCKS}/router/rules.json"
    rules = COMPOSE["services"]["router"]["environment"]["COUNTERPOINT_ZENOH_CONFIG"]
    assert rules == f"{LOCKS}/rules.json"


def test_prometheus_scrapes_what_compose_starts() -> None:
    config = yaml.safe_load((DEPLOY / "prometheus" / "prometheus.yml").read_text())
    jobs = {job["job_name"]: job for job in config["scrape_configs"]}
    listen = environment_of(stage("service"))["COUNTERPOINT_HTTP_LISTEN"].rpartition(":")[2]
    assert jobs["counterpoint"]["static_configs"] == [{"targets": [f"service:{listen}"]}]
    found = jobs["counterpoint-worker"]["dns_sd_configs"][0]
    port = environment_of(stage("worker"))["COUNTERPOINT_WORKER_HTTP_LISTEN"].rpartition(":")[2]
    assert found["names"] == ["worker"]
    assert str(found["port"]) == port


def test_grafana_is_told_every_variable_that_its_provisioning_takes() -> None:
    told = COMPOSE["services"]["grafana"]["environment"]
    for path in (DEPLOY / "grafana" / "provisioning").rglob("*.yaml"):
        yaml.safe_load(path.read_text())
        assert set(re.findall(r"\$\{(\w+)\}", path.read_text())) <= set(told)
    provider = yaml.safe_load(
        (DEPLOY / "grafana" / "provisioning" / "dashboards" / "counterpoint.yaml").read_text()
    )["providers"][0]
    mounts: dict[str, Any] = dict(
        reversed(mount.split(":")[:2]) for mount in COMPOSE["services"]["grafana"]["volumes"]
    )
    assert (DEPLOY / mounts[provider["options"]["path"]] / "disagreement.json").is_file()
    assert told["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"].startswith(provider["options"]["path"])


def test_the_unit_starts_a_verb_that_exists_and_leaves_the_drain_to_the_pool() -> None:
    unit = (DEPLOY / "systemd" / "counterpoint.service").read_text()
    started = re.search(r"^ExecStart=\S+/counterpoint (.+)$", unit, re.M)
    assert started is not None
    check_command(started[1].split())
    # A worker takes a second SIGTERM as an order to end at once.
    assert "\nKillMode=mixed\n" in unit
    stop = re.search(r"^TimeoutStopSec=(\d+)$", unit, re.M)
    assert stop is not None
    assert int(stop[1]) > DRAIN_S + KILL_MARGIN_S
    assert "MemoryDenyWriteExecute=" not in unit  # loops are compiled while running


def test_the_unit_of_the_page_is_as_hardened_and_starts_a_verb_that_exists() -> None:
    both = [(DEPLOY / "systemd" / name).read_text() for name in UNITS]
    started = re.search(r"^ExecStart=\S+/counterpoint (.+)$", both[1], re.M)
    assert started is not None
    check_command(started[1].split())
    # Before the service has made its state, the page ends with 1.
    assert "\nRestart=on-failure\n" in both[1]
    assert "RestartPreventExitStatus" not in both[1]
    hardened = [
        set(re.findall(r"^((?:Protect|Private|Restrict|SystemCall|NoNew|Cap).+)$", unit, re.M))
        for unit in both
    ]
    assert hardened[0] == hardened[1]


def test_the_unit_tries_again_what_may_pass_and_nothing_else() -> None:
    unit = (DEPLOY / "systemd" / UNITS[0]).read_text()
    assert "\nRestart=on-failure\n" in unit
    stays_down = re.search(r"^RestartPreventExitStatus=(.+)$", unit, re.M)
    assert stays_down is not None
    assert "1" in stays_down[1].split()
    assert str(EX_TEMPFAIL) not in stays_down[1].split()


def test_the_example_of_credentials_sets_none_to_nothing() -> None:
    # An empty key in the environment hides the role that a machine may have.
    text = (DEPLOY / "counterpoint.env.example").read_text(encoding="utf-8")
    assert re.findall(r"^\w+=\s*$", text, re.M) == []
