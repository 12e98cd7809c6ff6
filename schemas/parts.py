"""Names of the parts that settings accept, each with the line that `--help` shows.

`workers.parts.registry` builds them; a test compares its names with these.
"""

from collections.abc import Mapping
from typing import Final, Literal

from schemas.mining import LOOKAHEAD

PartSetting = Literal["odometry", "supervised", "selfsupervised", "witness", "instances"]

_RULE: Final = "The paper's clustering, numbers per second"
_FLOWS: Final[Mapping[str, str]] = {
    "nearest-neighbour": "each point goes to the nearest one",
    "registered-clusters": "each cluster goes where it fits best",
    "tracked": "only points that the default stream confirmed as dynamic have flow",
    "flowstep3d": "FlowStep3D estimates the flow of each point within 35 m beyond ego-motion",
}

PART_LINES: Final[Mapping[PartSetting, Mapping[str, str]]] = {
    "odometry": {
        "kiss-icp": "Point-to-point ICP against a local map, its trust checked frame by frame.",
        "delora": "A network estimates the motion between two frames; the poses have no health.",
    },
    "supervised": {
        "salsanext-lmnet": "SalsaNext labels movable classes, LMNet motion, both on one range "
        "image.",
        "salsanext-lmnet:published": "The same, with the bugs of the published image, residuals "
        "and votes.",
        "recorded": "Labels that the model on the car wrote into the log.",
        "own": "Your exported network over range images or points.",
        "salsanext:ground": "Task ground: SalsaNext labels points on road, sidewalk, terrain.",
        "recorded:ground": "Task ground: classes that the model on the car wrote into the log, by "
        "their names.",
    },
    "selfsupervised": {
        "registration": "Clusters registered over time, verified by free space, tracked; ground by "
        "Patchwork++.",
        f"registration{LOOKAHEAD}0.5": "The same, with labels half a second later that also use "
        "later free space.",
        f"registration{LOOKAHEAD}1.0": "The same, with labels a second later that also use later "
        "free space.",
        "paper": "GndNet, the camera's view, FlowStep3D, two-stage clustering as published.",
        "two-stage": f"{_RULE}; {_FLOWS['nearest-neighbour']}.",
        **{f"two-stage:{flow}": f"{_RULE}; {goes}." for flow, goes in _FLOWS.items()},
        **{
            f"two-stage:{flow}:published": f"As two-stage:{flow}, numbers as published, per frame."
            for flow in _FLOWS
        },
        "ground": "Task ground: Patchwork++ on each frame.",
    },
    "witness": {
        "free-space": "Free space a second before and after: a point in it is not static.",
        "none": "No witness in addition to the two streams.",
    },
    "instances": {
        "default": "DBSCAN over places of 0.1 m, instances of 10 points and more.",
        "paper": "DBSCAN over points, instances of 25 points and more, as published.",
    },
}
