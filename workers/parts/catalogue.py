"""Catalogue of replaceable parts: source, licence, and required weights of each.

`workers.parts.registry` builds parts by name, and `schemas.parts` describes each in a line. This
module describes the rest, without loading any part.
"""

from collections.abc import Mapping
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from schemas.mining import LOOKAHEAD, MiningSettings
from schemas.parts import PART_LINES, PartSetting
from workers.paper.scene_flow import LEARNED_FLOWS
from workers.parts.networks import NETWORKS
from workers.parts.registry import INSTANCES, ODOMETRIES, SELFSUPERVISED, SUPERVISED, WITNESSES

PartKind = PartSetting | Literal["network"]


class PartCard(BaseModel):
    """A part that can be chosen by name, or a network that parts are built from."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    part: PartKind = Field(
        description="The setting that names it, or: a network, whose weights are imported."
    )
    name: str = Field(description="As the setting says it.")
    default: bool = Field(description="Whether it is what runs if nothing is said.")
    paper: bool = Field(description="Whether it is a part of the paper's chain.")
    what: str = Field(description="What it does, in a sentence.")
    source: str = Field(description="Where the method is from.")
    licence: str = Field(description="Of the code that runs.")
    weights: str = Field(description="What weights it needs, and whether they ship; none: nothing.")


class _Card(BaseModel):
    model_config = ConfigDict(frozen=True)

    source: str
    paper: bool = False
    licence: str = "Apache-2.0"
    weights: str = "none"


class _NetworkCard(_Card):
    what: str


_ODOMETRY: Final[Mapping[str, _Card]] = {
    "kiss-icp": _Card(
        source="KISS-ICP (Vizzo et al., RA-L 2023); the paper has DeLORA",
        licence="MIT (kiss-icp)",
    ),
    "delora": _Card(
        source="DeLORA (Nubert et al., ICRA 2021)",
        paper=True,
        weights="delora, imported; none ship",
    ),
}

_SUPERVISED: Final[Mapping[str, _Card]] = {
    "salsanext-lmnet": _Card(
        source="SalsaNext (Cortinhal et al., 2020), LiDAR-MOS (Chen et al., RA-L 2021)",
        weights="ships: width 8, simulated streets and PandaSet (CC BY 4.0); or a folder in the "
        "setting weights",
    ),
    "salsanext-lmnet:published": _Card(
        source="SalsaNext (Cortinhal et al., 2020), LiDAR-MOS (Chen et al., RA-L 2021)",
        paper=True,
        weights="salsanext and lmnet, imported; those that ship otherwise",
    ),
    "recorded": _Card(source="the log"),
    "own": _Card(
        source="yours",
        licence="yours (run by Apache-2.0 code, ONNX by onnxruntime, MIT)",
        weights="ONNX, TorchScript or torch.export, named by the adapter in the setting model",
    ),
    "salsanext:ground": _Card(
        source="SalsaNext (Cortinhal et al., 2020)",
        weights="salsanext alone, as salsanext-lmnet",
    ),
    "recorded:ground": _Card(source="the log"),
}

_RULE_OF_INSTANCES: Final = "arXiv 2407.14306, section III-C"
_RULE: Final = "arXiv 2407.14306, section III-B"
_REGISTRATION: Final = "own; Patchwork++ (Lee et al., IROS 2022)"
_REGISTRATION_LICENCE: Final = "Apache-2.0; BSD-2-Clause (pypatchworkpp)"
_SELFSUPERVISED: Final[Mapping[str, _Card]] = {
    "registration": _Card(
        source=_REGISTRATION,
        licence=_REGISTRATION_LICENCE,
    ),
    **{
        f"registration{LOOKAHEAD}{lookahead_s}": _Card(
            source=_REGISTRATION,
            licence=_REGISTRATION_LICENCE,
        )
        for lookahead_s in ("0.5", "1.0")
    },
    "paper": _Card(
        source=f"{_RULE}; GndNet (Paigwar et al., 2020), FlowStep3D (Kittenplon et al., 2021)",
        paper=True,
        weights="gndnet and flowstep3d, imported; none ship; a camera's calibration",
    ),
    "two-stage": _Card(source=_RULE),
    "ground": _Card(
        source="Patchwork++ (Lee et al., IROS 2022)",
        licence=_REGISTRATION_LICENCE,
    ),
}

_WITNESS: Final[Mapping[str, _Card]] = {
    "free-space": _Card(source="own"),
    "none": _Card(source="none", paper=True),
}

_INSTANCES: Final[Mapping[str, _Card]] = {
    "default": _Card(
        source=f"{_RULE_OF_INSTANCES}; DBSCAN (Ester et al., 1996)",
        licence="Apache-2.0; BSD-3-Clause (scikit-learn)",
    ),
    "paper": _Card(
        source=f"{_RULE_OF_INSTANCES}; DBSCAN (Ester et al., 1996)",
        licence="Apache-2.0; BSD-3-Clause (scikit-learn)",
        paper=True,
    ),
}

_NETWORKS: Final[Mapping[str, _NetworkCard]] = {
    "salsanext": _NetworkCard(
        paper=True,
        what="Semantic classes over a range image.",
        source="Cortinhal, Tzelepis, Aksoy, 2020",
        weights="ships for salsanext-lmnet (width 8); published ones by weights import, configs "
        "salsanext-semantickitti, salsanext-kitti360",
    ),
    "lmnet": _NetworkCard(
        paper=True,
        what="Moving or static over a range image and its residuals.",
        source="LiDAR-MOS (Chen et al., RA-L 2021)",
        weights="ships for salsanext-lmnet (width 8); published ones by weights import, configs "
        "lmnet-semantickitti-1, lmnet-semantickitti-8, lmnet-kitti360-8",
    ),
    "gndnet": _NetworkCard(
        paper=True,
        what="Height of the ground in cells of a metre.",
        source="Paigwar et al., IROS 2020",
        weights="none ship; published ones by weights import, config gndnet-semantickitti",
    ),
    "flowstep3d": _NetworkCard(
        paper=True,
        what="Scene flow between two clouds.",
        source="Kittenplon, Eldar, Raviv, CVPR 2021",
        weights="none ship; published ones by weights import, config flowstep3d",
    ),
    "delora": _NetworkCard(
        paper=True,
        what="Motion of the sensor between two frames.",
        source="Nubert, Khattak, Hutter, ICRA 2021",
        weights="none ship; published ones by weights import, config delora-kitti",
    ),
}


def part_cards() -> list[PartCard]:
    """Describe every part, the default of each kind before the others; networks come last."""
    kinds: Mapping[PartSetting, list[str]] = {
        "odometry": list(ODOMETRIES),
        "supervised": list(SUPERVISED),
        "selfsupervised": list(SELFSUPERVISED),
        "witness": list(WITNESSES),
        "instances": list(INSTANCES),
    }
    chosen = [
        card
        for kind, names in kinds.items()
        for card in sorted((_card(kind, name) for name in names), key=lambda card: not card.default)
    ]
    return chosen + [
        PartCard(part="network", name=name, default=False, **_NETWORKS[name].model_dump())
        for name in NETWORKS
    ]


def _card(kind: PartSetting, name: str) -> PartCard:
    known = {
        "odometry": _ODOMETRY,
        "supervised": _SUPERVISED,
        "selfsupervised": _SELFSUPERVISED,
        "witness": _WITNESS,
        "instances": _INSTANCES,
    }
    card = known[kind].get(name) or _two_stage(name)
    chosen = MiningSettings.model_fields[kind].default
    return PartCard(
        part=kind,
        name=name,
        what=PART_LINES[kind][name],
        default=name == chosen,
        **card.model_dump(),
    )


def _two_stage(name: str) -> _Card:
    """Describe `two-stage:FLOW` and `two-stage:FLOW:published`."""
    _, flow, *rest = name.split(":")
    return _Card(
        source=f"{_RULE}; FlowStep3D (Kittenplon et al., 2021)" if flow in LEARNED_FLOWS else _RULE,
        paper=bool(rest),
        weights=f"{flow}, imported; none ship" if flow in LEARNED_FLOWS else "none",
    )
