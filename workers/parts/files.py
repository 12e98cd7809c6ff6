"""Files that parts read outside of the package, and a check for missing ones."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from workers.errors import UnknownPartError
from workers.paper.scene_flow import LEARNED_FLOWS


@dataclass(frozen=True, slots=True)
class PartFiles:
    """Files that parts read outside of the package.

    Attributes:
        model: Adapter of the user's own model; empty: none.
        weights: Folder of imported weights; empty: those that ship.
    """

    model: str = ""
    weights: str = ""


NETWORKS_OF: Final[Mapping[str, tuple[str, ...]]] = {
    "salsanext-lmnet": ("salsanext", "lmnet"),
    "salsanext-lmnet:published": ("salsanext", "lmnet"),
    "salsanext:ground": ("salsanext",),
    "paper": ("gndnet", "flowstep3d"),
    "delora": ("delora",),
    **{f"two-stage:{flow}": (flow,) for flow in LEARNED_FLOWS},
    **{f"two-stage:{flow}:published": (flow,) for flow in LEARNED_FLOWS},
}
"""Networks whose weights a part loads; SalsaNext and LMNet ship, and are the default without a
folder."""


def all_there(files: PartFiles, *parts: str) -> None:
    """Raise an error that names every network missing in the folder of weights at once."""
    needed = [network for part in parts for network in NETWORKS_OF.get(part, ())]
    folder = Path(files.weights)
    if files.weights and not folder.is_dir():
        raise UnknownPartError(f"weights: there is no such folder ({folder})")
    missing = [each for each in needed if not (folder / f"{each}.safetensors").is_file()]
    if files.weights and missing:
        raise UnknownPartError(
            f"the folder of weights lacks {', '.join(missing)}, which the chosen parts need: "
            "`counterpoint weights import CHECKPOINT --network NAME --config CONFIG --out FOLDER` "
            f"for each; `counterpoint weights configs` lists those of published ones ({folder})"
        )


def weights_of(files: PartFiles, what: str, name: str) -> Path:
    """Return the folder of weights of a part whose networks do not ship.

    Args:
        files: Files that the settings name.
        what: Kind of the part, for the message.
        name: Name of the part.

    Raises:
        UnknownPartError: If no folder is named.
    """
    if not files.weights:
        networks = ", ".join(NETWORKS_OF[name])
        raise UnknownPartError(
            f"{what} {name} needs weights that do not ship ({networks}): import them with "
            "`counterpoint weights import` and name their folder in the setting weights"
        )
    return Path(files.weights)
