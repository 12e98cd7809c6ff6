"""Label export: writes evaluated labels in the format of the truth, for checks by others."""

from pathlib import Path
from typing import Final

import numpy as np

from workers.lab.evaluation.motion.motion import EvaluatedFrame
from workers.lab.evaluation.truth.truth import TRUTH_DYNAMIC, TRUTH_STATIC, TRUTH_UNKNOWN

TRUTH_CODES: Final = np.array([TRUTH_STATIC, TRUTH_DYNAMIC, TRUTH_UNKNOWN], dtype=np.uint8)
"""Truth code of each `MotionLabel`, in the order of their values."""


def write_labels(folder: Path, judged: EvaluatedFrame) -> Path:
    """Write the labels of one frame to `folder/x/y/NNNNNN.npz`.

    The arrays have an entry for every point of the recorded cloud: `motion` in codes of the truth,
    and `confirmed`, false for a stream that confirms nothing. Points of removed beams are unknown;
    `kept` then marks the others.
    """
    motion = TRUTH_CODES[judged.labels]
    confirmed = judged.confirmed
    if confirmed is None:
        confirmed = np.zeros(len(motion), np.bool_)
    arrays = {"motion": motion, "confirmed": confirmed}
    if judged.kept is not None:
        for name, array in arrays.items():
            whole = np.zeros(len(judged.kept), array.dtype)
            whole[judged.kept] = array
            arrays[name] = whole
        arrays["kept"] = judged.kept
    path = folder / f"{judged.name}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, allow_pickle=False, **arrays)
    return path
