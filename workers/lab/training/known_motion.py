"""Loss of DeLORA unless published: error of a known motion that was added to the second scan."""

from typing import Final, cast

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from workers.paper.delora import BasicBlock, DeLORA, Motion

SPREAD_M: Final = (1.0, 0.2, 0.1)
SPREAD_DEG: Final = (2.0, 0.4, 0.4)
"""Standard deviations of the widest added motion: along x, y, z, metres; yaw, pitch, roll, degrees.

A car drives ahead. After the motion before, an error of a metre is that of a first frame."""

_NARROWEST: Final = 0.03
"""Share of the spread that the narrowest added motion has: 3 cm ahead, 0.06 degrees of yaw.

What constant velocity leaves of a frame is a centimetre, so that small motions must be learnt as
well as wide ones."""

LEVER_M: Final = 15.0
"""Distance at which an angle counts as a length, metres: the median range of a scan on a street."""

_DIFFERENCE: Final = 0.5
_SURROUNDINGS: Final = 0.1
_PLACE: Final = 0.025
"""Deviations of the first kernels: of the difference of both images in a pixel and around it, and
of the first image itself, per metre. A difference of 1 m, and a place 20 m away, are about where a
tanh bends."""

_PLACE_CHANNELS: Final = 16
"""Channels of the first layer, the last ones, that see the first image alone."""

_BRANCH: Final = 0.5
"""Factor on the last kernel of a block, so that eight blocks in a row do not saturate."""

_STILL: Final = 0.1
"""Factor on the last weights of translation and rotation, so that the network begins near rest."""


def drawn_motion(rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw a motion, (4, 4): each width from narrow to wide is as likely as any other."""
    width = np.exp(rng.uniform(np.log(_NARROWEST), 0.0))
    further = np.eye(4)
    angles = rng.normal(size=3) * SPREAD_DEG * width
    further[:3, :3] = Rotation.from_euler("zyx", angles, degrees=True).as_matrix()
    further[:3, 3] = rng.normal(size=3) * SPREAD_M * width
    return further


def motion_errors(this_from_next: Tensor, expected: Tensor) -> tuple[Tensor, Tensor]:
    """Return the errors of motions, (B, 3) metres and (B, 3) sine of the angle about each axis.

    Args:
        this_from_next: (B, 4, 4) estimates.
        expected: (B, 4, 4) known motions.
    """
    turn = this_from_next[:, :3, :3] @ expected[:, :3, :3].transpose(1, 2)
    about = torch.stack(
        (
            turn[:, 2, 1] - turn[:, 1, 2],
            turn[:, 0, 2] - turn[:, 2, 0],
            turn[:, 1, 0] - turn[:, 0, 1],
        ),
        dim=1,
    )
    return this_from_next[:, :3, 3] - expected[:, :3, 3], about / 2


def known_motion_loss(motion: Motion, expected: Tensor) -> Tensor:
    """Return the mean absolute error of motions, (B,), metres; an angle counts at `LEVER_M`."""
    shift, turn = motion_errors(motion.this_from_next, expected)
    return shift.abs().sum(dim=1) + LEVER_M * turn.abs().sum(dim=1)


def begin_at_rest(net: DeLORA) -> None:
    """Draw parameters with which the network compares both images, and estimates no motion.

    With weights as torch draws them, inputs in metres saturate the first tanh, and seventeen
    convolutions shrink what is left. Then the mean over all pixels is the same for any motion.
    """
    with torch.no_grad():
        first = net.resnet.conv1.weight
        outputs, inputs, high, wide = first.shape
        each = inputs // 2
        compared = torch.randn(outputs, each, high, wide) * _SURROUNDINGS
        compared[:, :, high // 2, wide // 2] += torch.randn(outputs, each) * _DIFFERENCE
        compared[-_PLACE_CHANNELS:] = 0
        first[:, :each] = compared + torch.randn(outputs, each, high, wide) * _PLACE
        first[:, each:] = -compared
        for module in net.modules():
            if isinstance(module, BasicBlock):
                for kernel in module.modules():
                    if isinstance(kernel, nn.Conv2d):
                        nn.init.kaiming_normal_(kernel.weight, nonlinearity="linear")
                module.conv2.weight.mul_(_BRANCH)
        translation, rotation = (
            cast(nn.Linear, head[-1])
            for head in (net.fully_connected_translation, net.fully_connected_rotation)
        )
        translation.weight.mul_(_STILL)
        translation.bias.zero_()
        rotation.weight.mul_(_STILL / LEVER_M)
        rotation.bias.copy_(torch.tensor([0.0, 0.0, 0.0, 1.0]))
