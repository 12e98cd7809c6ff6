"""The Helm chart renders with four sets of values, and fits the schemas of Kubernetes."""

import json
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from service.settings.config import Settings
from tests.chart_rendering import CHART, NEEDED, SETS, helm, one, rendered
from tests.needed import needed

VERSIONS = ("1.25", "1.30", "1.34")
CUSTOM = {"PodMonitor", "ScaledObject", "ServiceMonitor"}
"""Kinds of operators, for which Kubernetes has no schema."""


def validator() -> Any:
    return needed("kubernetes_validate", "the extra `chart`")


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", SETS)
def test_every_manifest_fits_the_schema_of_kubernetes(name: str, version: str) -> None:
    manifests = rendered(SETS[name])
    assert len(manifests) > 8
    for manifest in manifests:
        if manifest["kind"] not in CUSTOM:
            validator().validate(manifest, version, strict=True)


def test_helm_finds_nothing_wrong() -> None:
    found = helm().lint(CHART, NEEDED)
    assert [each for each in found["messages"] if each["severity"] > 1] == []
    assert found["errors"] == []


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"artifacts": "s3://b"}, "bucket"),
        (NEEDED | {"worker": {"gpu": 1}}, "gpu"),
        (NEEDED | {"settings": {"LEASE_S": "3"}}, "LEASE_S"),
        (NEEDED | {"service": {"database": "postgresql://user:secret@host/db"}}, "database"),
        (NEEDED | {"service": {"standby": True}}, "standby needs service.database"),
    ],
)
def test_values_that_cannot_be_meant_are_refused(values: dict[str, Any], named: str) -> None:
    with pytest.raises(helm().HelmError, match=named):
        rendered(values)


def test_two_services_stand_by_without_a_volume() -> None:
    values = {"service": {"standby": True, "database": "postgresql://app@db/fleet"}}
    manifests = rendered(NEEDED | values)
    service = one(manifests, "Deployment", "fleet-service")
    assert service["spec"]["replicas"] == 2
    variables = {
        each["name"]: each.get("value")
        for each in service["spec"]["template"]["spec"]["containers"][0]["env"]
    }
    assert variables["COUNTERPOINT_STANDBY"] == "true"
    assert "PersistentVolumeClaim" not in {each["kind"] for each in manifests}
    validator().validate(service, VERSIONS[0], strict=True)


def test_pods_without_locks_are_said_to_be_insecure() -> None:
    with pytest.raises(helm().HelmError, match="set insecure=true"):
        rendered(NEEDED | {"insecure": False})


def test_pods_with_locks_see_their_own_files_alone() -> None:
    parts = {"router": "rules.json", "service": "tokens", "worker": "tokens", "review": "tokens"}
    manifests = rendered(SETS["locked"])
    for part, also in parts.items():
        kind = "StatefulSet" if part == "router" else "Deployment"
        pod = one(manifests, kind, f"fleet-{part}")["spec"]["template"]["spec"]
        (volume,) = [each["secret"] for each in pod["volumes"] if "secret" in each]
        assert volume["secretName"] == "fleet-locks"
        assert volume["defaultMode"] == 0o440
        seen = {each["key"] for each in volume["items"]}
        assert seen == {"ca.pem", f"{part}.pem", f"{part}.key", also}
        (container,) = pod["containers"]
        named = {each["name"]: each.get("value", "") for each in container["env"]}
        assert "COUNTERPOINT_INSECURE" not in named
        assert named["COUNTERPOINT_TLS_KEY"] == f"/etc/counterpoint/{part}.key"
        said = (*container["args"], *named.values())
        assert not [each for each in said if "tcp/" in each]


def test_prometheus_asks_locked_pods_by_the_authority_and_with_a_token() -> None:
    monitor = one(rendered(SETS["locked"]), "PodMonitor", "fleet-worker")["spec"]
    (endpoint,) = monitor["podMetricsEndpoints"]
    assert endpoint["scheme"] == "https"
    assert endpoint["tlsConfig"]["serverName"] == "worker"
    assert endpoint["authorization"]["credentials"] == {"name": "fleet-viewer", "key": "token"}


def test_scaling_to_none_needs_keda() -> None:
    scaling = {"enabled": True, "kind": "external"}
    with pytest.raises(helm().HelmError, match="keda scales to 0"):
        rendered(NEEDED | {"worker": {"autoscaling": scaling}})


def test_every_value_has_a_default_and_a_schema() -> None:
    values = yaml.safe_load((CHART / "values.yaml").read_text(encoding="utf-8"))
    schema = json.loads((CHART / "values.schema.json").read_text(encoding="utf-8"))

    def names(tree: Any, part: Any, path: str = "") -> Iterator[str]:
        for name, child in part.get("properties", {}).items():
            if name == "global":
                continue
            assert name in tree, f"{path}{name} has no default in values.yaml"
            yield f"{path}{name}"
            if child.get("properties"):
                yield from names(tree[name], child, f"{path}{name}.")

    assert len(list(names(values, schema))) > 50


@pytest.mark.parametrize("name", SETS)
def test_every_variable_of_a_pod_is_a_setting(name: str) -> None:
    known = {f"COUNTERPOINT_{each.upper()}" for each in Settings.model_fields}
    for manifest in rendered(SETS[name]):
        pod = manifest.get("spec", {}).get("template", {}).get("spec", {})
        for container in pod.get("containers", ()):
            for variable in container.get("env", ()):
                assert variable["name"] in known | {"NUMBA_CACHE_DIR", "XDG_CACHE_HOME"}


def test_no_pod_runs_as_root_or_writes_to_its_root() -> None:
    for manifest in rendered(SETS["large"]):
        if manifest["kind"] in ("Deployment", "StatefulSet"):
            pod = manifest["spec"]["template"]["spec"]
            assert pod["securityContext"]["runAsNonRoot"] is True
            for container in pod["containers"]:
                assert container["securityContext"]["readOnlyRootFilesystem"] is True
                assert container["securityContext"]["capabilities"] == {"drop": ["ALL"]}


def test_a_worker_with_a_gpu_goes_where_there_is_one() -> None:
    pod = one(rendered(SETS["large"]), "Deployment", "fleet-worker")["spec"]["template"]["spec"]
    assert pod["nodeSelector"] == {"nvidia.com/gpu.present": "true"}
    assert pod["containers"][0]["resources"]["limits"]["nvidia.com/gpu"] == 1


def test_autoscaling_follows_waiting_and_leased_work() -> None:
    scaled = one(rendered(SETS["elastic"]), "ScaledObject", "fleet-worker")["spec"]
    (trigger,) = scaled["triggers"]
    assert trigger["metadata"]["query"] == (
        'sum(counterpoint_work{state=~"ready|leased", namespace="lidar"})'
    )
    assert "replicas" not in one(rendered(SETS["elastic"]), "Deployment", "fleet-worker")["spec"]
