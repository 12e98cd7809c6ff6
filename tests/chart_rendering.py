"""Rendering of the Helm chart by Helm's own engine, without a cluster and without a binary."""

from pathlib import Path
from typing import Any, Final

import yaml

from tests.needed import needed

CHART: Final = Path(__file__).parents[1] / "deploy" / "helm" / "counterpoint"
NEEDED: Final[dict[str, Any]] = {
    "bucket": "s3://fleet",
    "artifacts": "s3://fleet-overlays",
    "insecure": True,
}
SETS: Final[dict[str, dict[str, Any]]] = {
    "small": NEEDED,
    "large": NEEDED
    | {
        "existingSecrets": ["bucket-credentials"],
        "router": {"replicas": 3},
        "service": {"database": "postgresql://counterpoint@postgres/counterpoint"},
        "worker": {
            "gpus": 1,
            "nodeSelector": {"nvidia.com/gpu.present": "true"},
            "tolerations": [{"key": "nvidia.com/gpu", "operator": "Exists"}],
            "autoscaling": {"enabled": True, "kind": "external", "minReplicas": 1},
        },
        "networkPolicy": {"readers": {"team": "labels"}},
    },
    "locked": {"bucket": "s3://fleet", "artifacts": "s3://fleet-overlays"}
    | {
        "tls": {"secret": "fleet-locks"},
        "router": {"replicas": 2},
        "review": {"enabled": True, "hosts": ["review.fleet.example"]},
        "serviceMonitor": {"enabled": True, "tokenSecret": "fleet-viewer"},
    },
    "elastic": NEEDED
    | {
        "image": {"registry": "images.example.org/", "pullSecrets": ["pull"]},
        "settings": {"COUNTERPOINT_REMINE": "selected"},
        "service": {"persistence": {"enabled": False}},
        "serviceMonitor": {"enabled": True, "labels": {"release": "monitoring"}},
        "serviceAccount": {"annotations": {"role": "reads-fleet"}},
        "worker": {"autoscaling": {"enabled": True, "maxReplicas": 64}},
    },
}
"""Sets of values that are rendered and checked, by name."""


def helm() -> Any:
    """Return Helm's engine; in CI its absence is a failure, elsewhere the test is skipped."""
    return needed("helm_python", "the extra `chart`")


def rendered(values: dict[str, Any]) -> list[dict[str, Any]]:
    """Check values by the chart's schema, and return the manifests of a release `fleet`."""
    with helm().Chart.load(CHART) as chart:
        chart.validate_schema(values)
        texts = chart.render(values, name="fleet", namespace="lidar")
    return [each for text in texts.values() for each in yaml.safe_load_all(text) if each]


def one(manifests: list[dict[str, Any]], kind: str, name: str) -> dict[str, Any]:
    """Return the manifest of a kind and a name."""
    (found,) = [
        each for each in manifests if (each["kind"], each["metadata"]["name"]) == (kind, name)
    ]
    return found
