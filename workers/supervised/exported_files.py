"""Validation of torch.export archives, before torch opens them.

Such an archive is a program of torch's functions. Any other content is refused: compiled libraries,
pickled objects, and pickles of anything but tensors, whose code torch would run.
"""

import io
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

from workers.checkpoints.archives import Member, check_archive
from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.pickles import check_legacy, check_pickle

_FORCE: Final = "TORCH_FORCE_WEIGHTS_ONLY_LOAD"
_FORCE_NOT: Final = "TORCH_FORCE_NO_WEIGHTS_ONLY_LOAD"


def check_exported(members: Sequence[Member], *, source: object) -> None:
    """Check the members of an archive.

    Raises:
        WeightsUnusableError: If it contains a library, an object, or a pickle of more than tensors.
    """
    for member in members:
        if member.name.startswith("data/aotinductor"):
            raise WeightsUnusableError(
                f"the network holds compiled libraries, which are not run: export it without "
                f"AOTInductor ({source})"
            )
        if member.name.endswith("_config.json"):
            _check_payloads(member, source)
        elif member.name.endswith(".pt"):
            _check_saved(member.read(), source)


@contextmanager
def pickles_hold_tensors_alone() -> Iterator[None]:
    """Make torch read pickles with its restricted unpickler alone, within the block.

    Otherwise, torch.export falls back to the unrestricted one and runs the code in them.
    """
    variables = os.environ  # noqa: TID251 -- torch's switch, no setting of ours
    before = {name: variables.get(name) for name in (_FORCE, _FORCE_NOT)}
    variables[_FORCE] = "1"
    variables.pop(_FORCE_NOT, None)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                variables.pop(name, None)
            else:
                variables[name] = value


def _check_payloads(member: Member, source: object) -> None:
    """Check the entries of a table of weights or constants."""
    try:
        entries: Any = json.loads(member.read())["config"].values()
        odd = [
            entry["path_name"]
            for entry in entries
            if entry.get("use_pickle") or not str(entry["path_name"]).startswith(_TENSORS)
        ]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise WeightsUnusableError(
            f"the archive's table {member.name[:60]} is damaged ({source})"
        ) from error
    if odd:
        raise WeightsUnusableError(
            f"the network holds a pickled object ({str(odd[0])[:60]}), which is not read: export "
            f"one that holds tensors alone ({source})"
        )


_TENSORS: Final = ("weight_", "tensor_")


def _check_saved(data: bytes, source: object) -> None:
    """Check a file of torch.save: example inputs, and tensors of older versions."""
    if not data.startswith(b"PK"):
        if data:
            check_legacy(data, convert=False, source=source)
        return
    for member in check_archive(io.BytesIO(data), source=source):
        if member.name == "data.pkl":
            check_pickle(member.read(), convert=False, source=source)
