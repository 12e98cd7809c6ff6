"""Device that networks run on: the processor, or a GPU of CUDA where there is one."""

from typing import Final, Literal

import torch

from workers.checkpoints.errors import WeightsUnusableError

Device = Literal["cpu", "cuda"]
DEVICES: Final = ("auto", "cpu", "cuda")
"""Values of the setting `device`."""


def device_of(wanted: str) -> Device:
    """Return the device of a setting: `auto` takes a GPU where there is one.

    Raises:
        WeightsUnusableError: If `cuda` is wanted, and this machine or this torch has none.
    """
    has_cuda = torch.cuda.is_available()
    if wanted == "cuda" and not has_cuda:
        raise WeightsUnusableError(
            "device is cuda, but torch finds no GPU of CUDA here: set device to auto or cpu, or "
            "install a torch with CUDA and the driver of the GPU"
        )
    return "cuda" if has_cuda and wanted != "cpu" else "cpu"
