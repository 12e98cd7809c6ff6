"""Settings that belong together, by one name: a layer below everything that is written."""

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
"""`paper` is the published chain, bug for bug: SalsaNext and LMNet, GndNet, FlowStep3D, two-stage
clustering, instances of 25 points, in the view of the log's front camera. Its networks need the
setting `weights`; `--odometry delora` has the published odometry, too."""
