"""Checks of the published training losses and their gradients."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
import torch

from tests.golden.difference import Difference, relative, to_scale
from tests.golden.files import arrays, document
from workers.training.loss import segmentation_loss


def check_segmentation(folder: Path, file: Path) -> list[Difference]:
    """Compare weighted log loss plus Lovász-softmax of each network and data set."""
    del folder
    golden = arrays(file)
    differences = []
    for case, expected in document(file.with_suffix(".json")).items():
        logits = torch.from_numpy(golden[f"{case}_logits"]).requires_grad_()
        labels = torch.from_numpy(golden[f"{case}_labels"].astype(np.int64))
        loss = segmentation_loss(logits, labels, torch.tensor(expected["weights"]))
        (gradient,) = torch.autograd.grad(loss, logits)
        differences += [
            relative(f"{case} total", loss.item(), expected["total"], tolerance=1e-5),
            to_scale(
                f"{case} gradient",
                gradient.numpy(),
                golden[f"{case}_gradient_logits"],
                tolerance=1e-4,
            ),
        ]
    return differences


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "losses/segmentation_loss.npz": check_segmentation,
}
