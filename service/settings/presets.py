"""Presets: named groups of settings, which any written value overrides."""

from collections.abc import Mapping
from typing import Final, Literal

Preset = Literal["default", "paper"]

PRESETS: Final[Mapping[str, Mapping[str, str]]] = {
    "default": {},
    "paper": {
        "supervised": "salsanext-lmnet:published",
        "selfsupervised": "paper",
        "odometry": "kiss-icp",
        "witness": "none",
        "instances": "paper",
        "camera": "recorded",
    },
}
"""`paper` is the published chain with its bugs: SalsaNext and LMNet, GndNet, FlowStep3D, two-stage
clustering, instances of 25 points, in the view of the log's front camera. Its networks need the
setting `weights`; `--odometry delora` adds the published odometry.
"""
