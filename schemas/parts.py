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
    "tracked": "only what the default stream proved to move has flow",
    "flowstep3d": "FlowStep3D says where each point within 35 m goes beyond ego-motion",
}

PART_LINES: Final[Mapping[PartSetting, Mapping[str, str]]] = {
    "odometry": {
        "kiss-icp": "Point-to-point ICP against a local map, its trust checked frame by frame.",
        "delora": "A network says how the sensor moved between two frames; no trust in a pose is "
        "known.",
    },
    "supervised": {
        "salsanext-lmnet": "SalsaNext says what can move, LMNet what moves, both over one range "
        "image.",
        "salsanext-lmnet:published": "The same, with image, residuals and votes bug for bug.",
        "recorded": "Labels that the model on the car wrote into the log.",
        "own": "Your exported network over range images or points.",
        "salsanext:ground": "Task ground: SalsaNext says which points lie on road, sidewalk, "
        "terrain.",
        "recorded:ground": "Task ground: classes that the model on the car wrote into the log, by "
        "their names.",
    },
    "selfsupervised": {
        "registration": "Clusters registered over time, verified by free space, tracked; ground by "
        "Patchwork++.",
        f"registration{LOOKAHEAD}0.5": "The same, its labels half a second later: what is free "
        "after counts as well.",
        f"registration{LOOKAHEAD}1.0": "The same, its labels a second later: what is free after "
        "counts as well.",
        "paper": "GndNet, the camera's view, FlowStep3D, two-stage clustering as published.",
        "two-stage": f"{_RULE}; {_FLOWS['nearest-neighbour']}.",
        **{f"two-stage:{flow}": f"{_RULE}; {goes}." for flow, goes in _FLOWS.items()},
        **{
            f"two-stage:{flow}:published": f"As two-stage:{flow}, numbers as published, per frame."
            for flow in _FLOWS
        },
        "ground": "Task ground: what Patchwork++ finds in each frame.",
    },
    "witness": {
        "free-space": "Free space a second before and after: where something else was seen "
        "through, nothing stands.",
        "none": "Nobody is asked beside the two streams.",
    },
    "instances": {
        "default": "DBSCAN over places of 0.1 m, instances of 10 points and more.",
        "paper": "DBSCAN over points, instances of 25 points and more, as published.",
    },
}
