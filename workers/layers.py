"""Layers of the pipeline version: labels, contradictions, score.

Each module that mining imports is in exactly one layer. A layer depends on the ones before it
alone, so where only the score changed, it is computed again from what overlays keep.
"""

import hashlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Final

from schemas.canonical import canonical_json
from workers.contradiction.attribution import FILE
from workers.sources import digest_of, sources


class Layer(StrEnum):
    """Layer of the pipeline version.

    `labels`: reading of logs, odometry, both streams and the witness. `contradictions`: agreement,
    instances, tracks, features, overlays. `score`: attribution, ranking of tracks, score, record.
    """

    LABELS = "labels"
    CONTRADICTIONS = "contradictions"
    SCORE = "score"


ROOTS: Final = ("workers.ingest.plan", "workers.mine", "workers.parts.registry")
"""Modules that plan and mine a log; with all their imports they are the code of a record."""

_LABEL_ROOTS: Final = (
    "workers.ingest.plan",
    "workers.ingest.read",
    "workers.ingest.scenes",
    "workers.parts.registry",
)
_CONTRADICTION_ROOTS: Final = (
    "schemas.transport.overlay_codec",
    "workers.contradiction.agreement",
    "workers.contradiction.feature_extraction",
    "workers.contradiction.instances",
    "workers.contradiction.scene_statistics",
    "workers.contradiction.scoring_inputs",
    "workers.contradiction.tracks",
)
_OVERLAY: Final = frozenset({"workers.contradiction.overlay"})
"""Modules of the contradictions that import types of the score."""

_SCORE_ROOTS: Final = (
    "schemas.transport.wire",
    "workers.contradiction.attribution",
    "workers.contradiction.score",
    "workers.contradiction.track_score",
)
_WEIGHTS: Final = ".safetensors"


@dataclass(frozen=True, slots=True)
class LayerDigests:
    """Digest of each layer, 12 hexadecimal digits."""

    labels: str
    contradictions: str
    score: str

    @property
    def pipeline_version(self) -> str:
        """Return the version that the three layers make: 12 hexadecimal digits."""
        return short_digest([self.labels, self.contradictions, self.score])


def short_digest(facts: object) -> str:
    """Return 12 hexadecimal digits of the sha256 of facts in canonical JSON."""
    return hashlib.sha256(canonical_json(facts)).hexdigest()[:12]


@cache
def modules_of_layers() -> Mapping[Layer, frozenset[str]]:
    """Return the modules of each layer; together they are all that mining imports.

    A module that several layers import is in the first of them. One that none of their roots
    imports, such as the pipeline itself, is in `labels`: its change may change everything.
    """
    every = sources(*ROOTS)
    labels = sources(*_LABEL_ROOTS)
    contradictions = (sources(*_CONTRADICTION_ROOTS) | _OVERLAY) - labels
    score = sources(*_SCORE_ROOTS) - contradictions - labels
    return {
        Layer.LABELS: every - contradictions - score,
        Layer.CONTRADICTIONS: contradictions,
        Layer.SCORE: score,
    }


@cache
def source_digests() -> Mapping[Layer, str]:
    """Return the digest of each layer's syntax, with the fitted table in that of the score."""
    modules = modules_of_layers()
    table = resources.files("workers.contradiction").joinpath(FILE).read_bytes()
    return {
        Layer.LABELS: digest_of(modules[Layer.LABELS]),
        Layer.CONTRADICTIONS: digest_of(modules[Layer.CONTRADICTIONS]),
        Layer.SCORE: short_digest(
            [digest_of(modules[Layer.SCORE]), hashlib.sha256(table).hexdigest()]
        ),
    }


def shipped_digests() -> Mapping[Layer, str]:
    """Return the digest of each layer as it ships: code, fitted table and weights.

    Libraries and settings are left out, since they are the user's.
    """
    folder = resources.files("workers.supervised").joinpath("weights")
    weights = {
        file.name: hashlib.sha256(file.read_bytes()).hexdigest()
        for file in folder.iterdir()
        if file.name.endswith(_WEIGHTS)
    }
    found = source_digests()
    labels = short_digest([found[Layer.LABELS], weights])
    return {layer: short_digest(found[layer]) for layer in Layer} | {Layer.LABELS: labels}


if __name__ == "__main__":
    # python -m workers.layers RELEASE deploy/layers.json
    release, file = sys.argv[1:]
    stated = {"release": release, "layers": shipped_digests()}
    Path(file).write_bytes(canonical_json(stated) + b"\n")
