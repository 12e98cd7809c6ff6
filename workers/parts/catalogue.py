"""Every replaceable part: one row each, from which all else that knows parts is derived.

The names that settings take, the help of options, `counterpoint parts`, its page
`deploy/PARTS.md` and the registry read `PARTS`. A new part is a file, its factory and a row here.
Nothing that a part is made of is imported before its factory is called: the service reads this
table, too.
"""

from functools import partial
from typing import Final

from schemas.mining import LOOKAHEAD
from schemas.task import GROUND
from workers.errors import UnknownPartError
from workers.parts import factories
from workers.parts.part import KINDS, Part, PartKind

PARTS: Final[tuple[Part, ...]] = (
    Part(
        kind="odometry",
        name="kiss-icp",
        factory=factories.kiss_icp,
        text="Point-to-point ICP against a local map, its trust checked frame by frame.",
        source="KISS-ICP (Vizzo et al., RA-L 2023); the paper has DeLORA",
        licence="MIT (kiss-icp)",
    ),
    Part(
        kind="odometry",
        name="delora",
        factory=factories.delora,
        networks=("delora",),
        text="A network estimates the motion between two frames; the trust in a pose is unknown.",
        source="DeLORA (Nubert et al., ICRA 2021)",
        paper=True,
    ),
    Part(
        kind="supervised",
        name="salsanext-lmnet",
        factory=factories.salsanext_lmnet,
        networks=("salsanext", "lmnet"),
        ships=True,
        text="SalsaNext labels what can move, LMNet what moves, both over one range image.",
        source="SalsaNext (Cortinhal et al., 2020), LiDAR-MOS (Chen et al., RA-L 2021)",
        weights="ships: width 8, simulated streets and PandaSet (CC BY 4.0); or a folder in the "
        "setting weights",
    ),
    Part(
        kind="supervised",
        name="salsanext-lmnet:published",
        factory=partial(factories.salsanext_lmnet, published=True),
        networks=("salsanext", "lmnet"),
        ships=True,
        text="The same, with image, residuals and votes bug for bug.",
        source="SalsaNext (Cortinhal et al., 2020), LiDAR-MOS (Chen et al., RA-L 2021)",
        weights="salsanext and lmnet, imported; those that ship otherwise",
        paper=True,
    ),
    Part(
        kind="supervised",
        name="recorded",
        factory=factories.recorded,
        text="Labels that the model on the car wrote into the log.",
        source="the log",
    ),
    Part(
        kind="supervised",
        name="own",
        factory=factories.own,
        text="Your exported network over range images or points.",
        source="yours",
        licence="yours (run by Apache-2.0 code, ONNX by onnxruntime, MIT)",
        weights="ONNX, TorchScript or torch.export, named by the adapter in the setting model",
    ),
    Part(
        kind="supervised",
        name="salsanext:ground",
        factory=factories.salsanext_ground,
        networks=("salsanext",),
        ships=True,
        text="Task ground: SalsaNext labels the points on road, sidewalk and terrain.",
        source="SalsaNext (Cortinhal et al., 2020)",
        weights="salsanext alone, as salsanext-lmnet",
    ),
    Part(
        kind="supervised",
        name="recorded:ground",
        factory=partial(factories.recorded, task=GROUND),
        text="Task ground: classes that the model on the car wrote into the log, by their names.",
        source="the log",
    ),
    Part(
        kind="selfsupervised",
        name="registration",
        factory=factories.registration,
        text="Clusters registered over time, verified by free space, tracked; ground by "
        "Patchwork++.",
        source="own; Patchwork++ (Lee et al., IROS 2022)",
        licence="Apache-2.0; BSD-2-Clause (pypatchworkpp)",
    ),
    Part(
        kind="selfsupervised",
        name=f"registration{LOOKAHEAD}0.5",
        factory=partial(factories.registration, lookahead_s=0.5),
        text="The same, its labels half a second later: what is free after counts as well.",
        source="own; Patchwork++ (Lee et al., IROS 2022)",
        licence="Apache-2.0; BSD-2-Clause (pypatchworkpp)",
    ),
    Part(
        kind="selfsupervised",
        name=f"registration{LOOKAHEAD}1.0",
        factory=partial(factories.registration, lookahead_s=1.0),
        text="The same, its labels a second later: what is free after counts as well.",
        source="own; Patchwork++ (Lee et al., IROS 2022)",
        licence="Apache-2.0; BSD-2-Clause (pypatchworkpp)",
    ),
    Part(
        kind="selfsupervised",
        name="paper",
        factory=factories.paper,
        networks=("gndnet", "flowstep3d"),
        text="GndNet, the camera's view, FlowStep3D, two-stage clustering as published.",
        source="arXiv 2407.14306, section III-B; GndNet (Paigwar et al., 2020), FlowStep3D "
        "(Kittenplon et al., 2021)",
        weights="gndnet and flowstep3d, trained or imported; none ship; a camera's calibration",
        paper=True,
    ),
    Part(
        kind="selfsupervised",
        name="two-stage",
        factory=factories.nearest_neighbour,
        text="The paper's clustering, numbers per second; each point goes to the nearest one.",
        source="arXiv 2407.14306, section III-B",
    ),
    Part(
        kind="selfsupervised",
        name="two-stage:nearest-neighbour",
        factory=factories.nearest_neighbour,
        text="The paper's clustering, numbers per second; each point goes to the nearest one.",
        source="arXiv 2407.14306, section III-B",
    ),
    Part(
        kind="selfsupervised",
        name="two-stage:registered-clusters",
        factory=factories.registered_clusters,
        text="The paper's clustering, numbers per second; each cluster goes where it fits best.",
        source="arXiv 2407.14306, section III-B",
    ),
    Part(
        kind="selfsupervised",
        name="two-stage:tracked",
        factory=factories.tracked,
        text="The paper's clustering, numbers per second; only what the default stream proved to "
        "move has flow.",
        source="arXiv 2407.14306, section III-B",
    ),
    Part(
        kind="selfsupervised",
        name="two-stage:flowstep3d",
        factory=factories.flowstep3d,
        networks=("flowstep3d",),
        text="The paper's clustering, numbers per second; FlowStep3D estimates the motion of each "
        "point within 35 m beyond ego-motion.",
        source="arXiv 2407.14306, section III-B; FlowStep3D (Kittenplon et al., 2021)",
    ),
    Part(
        kind="selfsupervised",
        name="two-stage:nearest-neighbour:published",
        factory=partial(factories.nearest_neighbour, published=True),
        text="As two-stage:nearest-neighbour, numbers as published, per frame.",
        source="arXiv 2407.14306, section III-B",
        paper=True,
    ),
    Part(
        kind="selfsupervised",
        name="two-stage:registered-clusters:published",
        factory=partial(factories.registered_clusters, published=True),
        text="As two-stage:registered-clusters, numbers as published, per frame.",
        source="arXiv 2407.14306, section III-B",
        paper=True,
    ),
    Part(
        kind="selfsupervised",
        name="two-stage:tracked:published",
        factory=partial(factories.tracked, published=True),
        text="As two-stage:tracked, numbers as published, per frame.",
        source="arXiv 2407.14306, section III-B",
        paper=True,
    ),
    Part(
        kind="selfsupervised",
        name="two-stage:flowstep3d:published",
        factory=partial(factories.flowstep3d, published=True),
        networks=("flowstep3d",),
        text="As two-stage:flowstep3d, numbers as published, per frame.",
        source="arXiv 2407.14306, section III-B; FlowStep3D (Kittenplon et al., 2021)",
        paper=True,
    ),
    Part(
        kind="selfsupervised",
        name="ground",
        factory=factories.ground,
        text="Task ground: what Patchwork++ finds in each frame.",
        source="Patchwork++ (Lee et al., IROS 2022)",
        licence="Apache-2.0; BSD-2-Clause (pypatchworkpp)",
    ),
    Part(
        kind="witness",
        name="free-space",
        factory=factories.free_space,
        text="Free space a second before and after: a place that a beam passed through then is "
        "not static.",
        source="own",
    ),
    Part(
        kind="witness",
        name="none",
        factory=factories.no_witness,
        text="No third witness: the two streams alone.",
        source="none",
        paper=True,
    ),
    Part(
        kind="instances",
        name="default",
        factory=factories.default_instances,
        text="DBSCAN over places of 0.1 m, instances of 10 points and more.",
        source="arXiv 2407.14306, section III-C; DBSCAN (Ester et al., 1996)",
        licence="Apache-2.0; BSD-3-Clause (scikit-learn)",
    ),
    Part(
        kind="instances",
        name="paper",
        factory=factories.paper_instances,
        text="DBSCAN over points, instances of 25 points and more, as published.",
        source="arXiv 2407.14306, section III-C; DBSCAN (Ester et al., 1996)",
        licence="Apache-2.0; BSD-3-Clause (scikit-learn)",
        paper=True,
    ),
    Part(
        kind="network",
        name="salsanext",
        factory=factories.card_over_images,
        text="Semantic classes over a range image.",
        source="Cortinhal, Tzelepis, Aksoy, 2020",
        weights="ships for salsanext-lmnet (width 8); published ones by weights import, configs "
        "salsanext-semantickitti, salsanext-kitti360",
        paper=True,
    ),
    Part(
        kind="network",
        name="lmnet",
        factory=factories.card_over_images,
        text="Moving or static over a range image and its residuals.",
        source="LiDAR-MOS (Chen et al., RA-L 2021)",
        weights="ships for salsanext-lmnet (width 8); published ones by weights import, configs "
        "lmnet-semantickitti-1, lmnet-semantickitti-8, lmnet-kitti360-8",
        paper=True,
    ),
    Part(
        kind="network",
        name="gndnet",
        factory=factories.gndnet_card,
        text="Height of the ground in cells of a metre.",
        source="Paigwar et al., IROS 2020",
        weights="none ship; train gndnet, or weights import, config gndnet-semantickitti",
        paper=True,
    ),
    Part(
        kind="network",
        name="flowstep3d",
        factory=factories.flowstep3d_card,
        text="Scene flow between two clouds.",
        source="Kittenplon, Eldar, Raviv, CVPR 2021",
        weights="none ship; train flowstep3d, or weights import, config flowstep3d",
        paper=True,
    ),
    Part(
        kind="network",
        name="delora",
        factory=factories.delora_card,
        text="Motion of the sensor between two frames.",
        source="Nubert, Khattak, Hutter, ICRA 2021",
        weights="none ship; train delora, or weights import, config delora-kitti",
        paper=True,
    ),
)
"""In the order in which they are listed within their kind; the default of a kind is listed first.

`two-stage:FLOW` is the paper's rule on a scene flow, `two-stage:FLOW:published` the same with its
numbers as published, per frame; `two-stage` alone takes the nearest neighbour.
"""


def parts_of_kind(kind: PartKind) -> list[Part]:
    """Return the parts of a kind, in the order of the catalogue."""
    return [part for part in PARTS if part.kind == kind]


def names_of(kind: PartKind) -> list[str]:
    """Return the names that a setting can take, in the order of the catalogue."""
    return [part.name for part in parts_of_kind(kind)]


def find_part(kind: PartKind, name: str) -> Part:
    """Find a part by its name.

    Raises:
        UnknownPartError: If it does not exist; the message lists those that do.
    """
    for part in parts_of_kind(kind):
        if part.name == name:
            return part
    known = ", ".join(sorted(names_of(kind)))
    raise UnknownPartError(f"no {KINDS[kind]} {name!r}; known: {known}")
