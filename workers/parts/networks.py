"""Turns published checkpoints of the networks in the catalogue into weights of this project."""

import hashlib
import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final, cast

from schemas.runtime.named_file import open_named_file, read_named_file
from workers.checkpoints import stored_weights
from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.model_files import MAX_TEXT_BYTES, read_regular
from workers.checkpoints.parameter_loading import load_into
from workers.checkpoints.published import read_checkpoint
from workers.checkpoints.stored_weights import Card
from workers.parts.catalogue import find_part
from workers.parts.files import PartFiles

_CONFIGS: Final = resources.files("workers.checkpoints") / "configs"


def _card_type(network: str) -> type[Card]:
    """Return the type of the card of a network; the networks load only when one is wanted.

    Raises:
        UnknownPartError: If there is no such network.
    """
    return cast("type[Card]", find_part("network", network).factory(PartFiles()))


def known_configs() -> tuple[str, ...]:
    """Return the names of the configurations in the package: those of published checkpoints."""
    return tuple(sorted(file.name.removesuffix(".json") for file in _CONFIGS.iterdir()))


def read_known(name: str) -> Card:
    """Read a configuration of the package.

    Raises:
        WeightsUnusableError: If there is none of that name.
    """
    if name not in known_configs():
        raise WeightsUnusableError(
            f"no configuration {name!r}; known: {', '.join(known_configs())}"
        )
    said = (_CONFIGS / f"{name}.json").read_text("utf-8")
    return stored_weights.read_card(said, _card_type(json.loads(said)["network"]), source=name)


def read_config(config: str, network: str) -> Card:
    """Read the configuration of a network.

    Args:
        config: Name of one in the package, path of a JSON file, or JSON.
        network: The network it is for.

    Returns:
        The card of the weights.

    Raises:
        WeightsUnusableError: If it is missing, no JSON, for another network, or incomplete.
        UnknownPartError: If there is no such network.
    """
    card_type = _card_type(network)
    if config in known_configs():
        card = read_known(config)
        if card.network != network:
            raise WeightsUnusableError(
                f"configuration {config} is of {card.network}, not {network}"
            )
        return card
    if config.lstrip().startswith("{"):
        source, said = "configuration", config
    else:
        source = config
        try:
            said = read_regular(Path(config), what="the configuration", most=MAX_TEXT_BYTES).decode(
                "utf-8"
            )
        except (WeightsUnusableError, UnicodeDecodeError) as error:
            raise WeightsUnusableError(
                f"{error}; a JSON file, JSON, or one of {', '.join(known_configs())} is needed"
            ) from error
    card = stored_weights.read_card(_named(said, network, source), card_type, source=source)
    if card.network != network:
        raise WeightsUnusableError(
            f"the configuration is of {card.network}, not {network} ({source})"
        )
    return card


def _named(said: str, network: str, source: str) -> str:
    """Add the network to a configuration that does not name it: the user has named it."""
    try:
        document: Any = json.loads(said)
    except (ValueError, RecursionError) as error:
        raise WeightsUnusableError(f"the configuration is no JSON: {error} ({source})") from error
    return json.dumps({"network": network} | document) if isinstance(document, dict) else said


@dataclass(frozen=True, slots=True)
class Imported:
    """Result of an import.

    Attributes:
        path: The `.safetensors` file; its card has the suffix `.json`.
        network: Name of the network.
        parameters: Number of tensors.
        digest: Hex sha256 of both files, which enters the version of the part that uses them.
        converted: Whether the checkpoint contained training state, which was dropped.
    """

    path: Path
    network: str
    parameters: int
    digest: str
    converted: bool


def import_weights(checkpoint: Path, *, network: str, config: str, out: Path) -> Imported:
    """Convert a published checkpoint to weights that parts can load: `out/NETWORK.safetensors`.

    Nothing is written unless every parameter fits. The numbers are unchanged.

    Args:
        checkpoint: As `read_checkpoint` takes it.
        network: Name of a network in the catalogue.
        config: As `read_config` takes it.
        out: Folder, made if need be.

    Returns:
        Path, digest and origin of the weights.

    Raises:
        WeightsUnusableError: If anything is missing, damaged, does not fit, or contains code.
        UnknownPartError: If there is no such network.
    """
    card = read_config(config, network)
    net = card.build()
    converted = False
    try:
        parameters = read_checkpoint(checkpoint)
    except WeightsUnusableError:
        parameters = read_checkpoint(checkpoint, convert=True)
        converted = True
    load_into(net, parameters, source=checkpoint)
    origin = {"imported_from": checkpoint.name, _ORIGIN: _digest_of(checkpoint)}
    card = card.model_copy(update={"training": {**card.training, **origin}})
    path = out / f"{network}.safetensors"
    stored_weights.save(path, net.state_dict(), card)
    digest = stored_weights.load(path, type(card), lambda read: read.build()).digest
    return Imported(path, network, len(parameters), digest, converted)


def need_no_other_weights(path: Path, checkpoint: Path) -> None:
    """Refuse to replace weights unless they were imported from this very checkpoint.

    Args:
        path: Target of the import.
        checkpoint: Checkpoint to import.

    Raises:
        WeightsUnusableError: If the target has other weights, or the checkpoint cannot be read.
    """
    card = path.with_suffix(".json")
    there = next((each for each in (path, card) if each.exists()), None)
    if there is None:
        return
    try:
        training = json.loads(read_named_file(card))["training"]
        if training[_ORIGIN] == _digest_of(checkpoint):
            return
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        pass  # what cannot be read was not imported from this checkpoint
    raise WeightsUnusableError(
        f"other weights lie there: name another folder, or replace them with --force ({there})"
    )


_ORIGIN: Final = "imported_sha256"
"""Entry of a card: hex sha256 of the checkpoint."""


def _digest_of(checkpoint: Path) -> str:
    with open_named_file(checkpoint) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
