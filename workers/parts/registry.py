"""Builds parts by the names that settings give, from the rows of the catalogue."""

from pathlib import Path
from typing import TYPE_CHECKING, cast

from workers.errors import UnknownPartError
from workers.parts.catalogue import find_part
from workers.parts.files import PartFiles
from workers.parts.part import KINDS, PartKind
from workers.parts.protocols import NoWitness, Odometry, Parts, Stream, Witness

if TYPE_CHECKING:
    from workers.contradiction.settings import InstanceSettings


def build_parts(
    *,
    odometry: str,
    supervised: str,
    selfsupervised: str,
    witness: str = "free-space",
    instances: str = "default",
    files: PartFiles | None = None,
) -> Parts:
    """Build the parts of these names; `workers.parts.catalogue` lists those of each kind.

    Args:
        odometry: Name of an odometry.
        supervised: Name of a supervised stream.
        selfsupervised: Name of a self-supervised stream.
        witness: Name of a witness; it is not built where the task is not about motion.
        instances: Name of a rule of instances.
        files: What they read in addition to the files of the package.

    Raises:
        UnknownPartError: If one does not exist, with the known names in the message; or if it needs
            a file that is not named.
        PermanentError: If its weights or its model cannot be used.
    """
    files = files or PartFiles()
    if files.model and supervised != "own":
        raise UnknownPartError(
            f"model names your own model, but the supervised stream is {supervised}: choose it "
            f"with --supervised own; a folder of imported weights goes to --weights ({files.model})"
        )
    _need_weights(files, odometry=odometry, supervised=supervised, selfsupervised=selfsupervised)
    find_part("witness", witness)
    semantic = build_supervised(supervised, files)
    return Parts(
        odometry=build_odometry(odometry, files),
        supervised=semantic,
        selfsupervised=build_selfsupervised(selfsupervised, files),
        witness=_build_witness(witness, files) if semantic.task.moving else NoWitness(),
        instances=cast("InstanceSettings", _build("instances", instances, files)),
        own_model=semantic.version.partition("@")[0] if supervised == "own" else "",
    )


def build_odometry(name: str, files: PartFiles | None = None) -> Odometry:
    """Build the odometry of this name, or raise as `build_parts` does."""
    return cast(Odometry, _build("odometry", name, files))


def build_supervised(name: str, files: PartFiles | None = None) -> Stream:
    """Build the supervised stream of this name, or raise as `build_parts` does."""
    return cast(Stream, _build("supervised", name, files))


def build_selfsupervised(name: str, files: PartFiles | None = None) -> Stream:
    """Build the self-supervised stream of this name, or raise as `build_parts` does."""
    return cast(Stream, _build("selfsupervised", name, files))


def _build_witness(name: str, files: PartFiles) -> Witness:
    return cast(Witness, _build("witness", name, files))


def _build(kind: PartKind, name: str, files: PartFiles | None) -> object:
    """Call the factory of a part, once the weights that it needs are named.

    Raises:
        UnknownPartError: If the part does not exist, or its weights neither ship nor are named.
    """
    part, files = find_part(kind, name), files or PartFiles()
    if part.networks and not part.ships and not files.weights:
        raise UnknownPartError(
            f"{KINDS[kind]} {name} needs weights that do not ship ({', '.join(part.networks)}): "
            "import them with `counterpoint weights import` and name their folder in the setting "
            "weights"
        )
    return part.factory(files)


def _need_weights(files: PartFiles, **chosen: str) -> None:
    """Refuse a folder of weights that lacks a network, and name every one that it lacks.

    Raises:
        UnknownPartError: If a part does not exist, or the folder or a network in it is missing.
    """
    if not files.weights:
        return
    folder = Path(files.weights)
    if not folder.is_dir():
        raise UnknownPartError(f"weights: there is no such folder ({folder})")
    networks = [
        network
        for kind, name in chosen.items()
        for network in find_part(cast(PartKind, kind), name).networks
    ]
    missing = [each for each in networks if not (folder / f"{each}.safetensors").is_file()]
    if missing:
        raise UnknownPartError(
            f"the folder of weights lacks {', '.join(missing)}, which the chosen parts need: "
            "`counterpoint weights import CHECKPOINT --network NAME --config CONFIG --out FOLDER` "
            f"for each; `counterpoint weights configs` lists those of published ones ({folder})"
        )
