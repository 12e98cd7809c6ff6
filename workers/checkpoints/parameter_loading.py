"""Parameter loading: all parameters of a network, or none and an error that names differences."""

from collections.abc import Mapping, Sequence
from typing import Final

import torch
from torch import Tensor, nn

from workers.checkpoints.errors import UnfitWeightsError

_NAMED: Final = 5
"""Names listed in a message; the error's attributes contain all of them."""


def load_into(net: nn.Module, stored: Mapping[str, Tensor], *, source: object) -> None:
    """Load parameters after a check of every name, shape and number.

    Floating point numbers of any precision are converted to the network's. The network is unchanged
    when anything does not fit.

    Args:
        net: The network.
        stored: Parameters by name, without a prefix.
        source: Name of the weights in messages: a path.

    Raises:
        UnfitWeightsError: If a name is missing or unexpected, a shape or a kind of number differs,
            or a number is not finite.
    """
    expected = net.state_dict()
    _check_names(stored, expected, source)
    for name, value in expected.items():
        given = stored[name]
        if given.shape != value.shape:
            raise UnfitWeightsError(
                f"weights of {name} are {tuple(given.shape)}, the network needs "
                f"{tuple(value.shape)} ({source})"
            )
        if given.is_floating_point() != value.is_floating_point() or given.is_complex():
            raise UnfitWeightsError(
                f"weights of {name} are {given.dtype}, the network needs {value.dtype} ({source})"
            )
        if given.is_floating_point() and not torch.isfinite(given.float()).all():
            raise UnfitWeightsError(f"weights of {name} are not all finite ({source})")
    net.load_state_dict({name: stored[name].to(value.dtype) for name, value in expected.items()})


def _check_names(
    stored: Mapping[str, Tensor], expected: Mapping[str, Tensor], source: object
) -> None:
    missing = tuple(name for name in expected if name not in stored)
    unexpected = tuple(name for name in stored if name not in expected)
    if not missing and not unexpected:
        return
    if len(missing) == len(expected):
        problem = (
            f"weights are of another network: none of its {len(expected)} parameters is there, "
            f"but {_named(unexpected)}"
        )
    else:
        lacks = f"lack {_counted(missing)}: {_named(missing)}" if missing else ""
        holds = (
            f"hold {_counted(unexpected)} that the network has not: {_named(unexpected)}"
            if unexpected
            else ""
        )
        problem = "weights " + " and ".join(part for part in (lacks, holds) if part)
    raise UnfitWeightsError(f"{problem} ({source})", missing=missing, unexpected=unexpected)


def _counted(names: Sequence[str]) -> str:
    return f"{len(names)} parameter{'' if len(names) == 1 else 's'}"


def _named(names: Sequence[str]) -> str:
    """List the first few names."""
    more = len(names) - _NAMED
    listed = ", ".join(names[:_NAMED]) or "nothing"
    return f"{listed} and {more} more" if more > 0 else listed
