"""Checks of the networks: published names, recipe parameters, published outputs."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
import torch

from tests.golden.difference import Difference, near, same
from tests.golden.files import arrays, parameters
from workers.supervised.lmnet import LMNet
from workers.supervised.salsanext import SalsaNext

CLEAR = 1e-5
"""Where the two best classes differ by less, rounding decides which is best."""


def check_salsanext(folder: Path, file: Path) -> list[Difference]:
    """Compare SalsaNext, 5 channels, 20 classes."""
    return _range_image_network(folder, file, "salsanext", SalsaNext())


def check_lmnet(folder: Path, file: Path) -> list[Difference]:
    """Compare LMNet, 8 residuals."""
    return _range_image_network(folder, file, "lmnet", LMNet(residuals=8))


def _range_image_network(folder: Path, file: Path, name: str, net: SalsaNext) -> list[Difference]:
    golden, filled = arrays(file), parameters(folder, name)
    keys = list(net.state_dict())
    differing_keys = len(set(filled) ^ set(keys))
    named = Difference("parameter names", differing_keys, 0.0, list(filled) == keys)
    if not named.holds:
        return [named]
    net.load_state_dict({key: torch.from_numpy(value) for key, value in filled.items()})
    with torch.inference_mode():
        logits = net.eval().forward_logits(torch.from_numpy(golden["input"]))
        shares = torch.softmax(logits, dim=1).numpy()
    second, first = np.sort(shares, axis=1)[:, -2:].swapaxes(0, 1)
    clear = first - second > CLEAR
    found = [
        named,
        near("softmax", shares, golden["softmax"], tolerance=1e-5),
        same("argmax where clear", shares.argmax(axis=1)[clear], golden["argmax"][clear]),
    ]
    if "logits" in golden:
        found.append(near("logits", logits.numpy(), golden["logits"], tolerance=5e-5))
    return found


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "networks/salsanext_*.npz": check_salsanext,
    "networks/lmnet_*.npz": check_lmnet,
}
