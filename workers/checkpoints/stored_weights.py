"""Weights in the project's format: a safetensors file with a JSON card in the same folder."""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Literal, TypeVar

import safetensors.torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from torch import Tensor, nn

from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.model_files import MAX_TEXT_BYTES, read_regular
from workers.checkpoints.parameter_loading import load_into
from workers.checkpoints.published import read_safetensors


class Card(BaseModel, ABC):
    """Card of any network: origin, licence, training and scores; networks add their own fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    format_version: Literal[1] = 1
    network: str
    attribution: str = Field(description="Where the weights or their training data came from.")
    data_license: str = Field(description="Licence of the weights or of their training data.")
    training: dict[str, str | int | float] = Field(
        default={}, description="How the weights were made."
    )
    scores: dict[str, float] = Field(default={}, description="Measured when they were made.")

    @abstractmethod
    def build(self) -> nn.Module:
        """Build the network, with random parameters.

        Raises:
            WeightsUnusableError: If the card contradicts itself.
        """


NetType = TypeVar("NetType", bound=nn.Module)
CardType = TypeVar("CardType", bound=Card)


@dataclass(frozen=True, slots=True)
class Stored(Generic[NetType, CardType]):
    """Weights that fit their network.

    Attributes:
        net: The network in evaluation mode, float32.
        card: Card of the weights.
        digest: Hex sha256 of both files' bytes.
    """

    net: NetType
    card: CardType
    digest: str


def save(path: Path, tensors: Mapping[str, Tensor], card: Card) -> None:
    """Write both files, each atomically.

    Args:
        path: The `.safetensors` file; the card has the suffix `.json`.
        tensors: Parameters by published name.
        card: Card of the weights.

    Raises:
        WeightsUnusableError: If the folder cannot be written.
    """
    packed = safetensors.torch.save(
        {name: value.detach().contiguous().cpu() for name, value in tensors.items()}
    )
    said = json.dumps(card.model_dump(mode="json"), indent=1) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(path, packed)
        _write(path.with_suffix(".json"), said.encode())
    except OSError as error:
        raise WeightsUnusableError(
            f"cannot write weights: {error.strerror or error}; free space or name another folder "
            f"({error.filename or path})"
        ) from error


def _write(path: Path, content: bytes) -> None:
    aside = path.with_name(f".{path.name}.part")
    aside.write_bytes(content)
    aside.replace(path)


def load(
    path: Path, card_type: type[CardType], build: Callable[[CardType], NetType]
) -> Stored[NetType, CardType]:
    """Load weights after checking that every parameter is there and fits; no partial load.

    Args:
        path: The `.safetensors` file; its card is in the same folder.
        card_type: Type of the card.
        build: Builds the network of a card.

    Returns:
        The network in evaluation mode.

    Raises:
        WeightsUnusableError: If a file is missing or damaged, or names, shapes or numbers do not
            fit; the message names the file and what differs.
    """
    what = "the weights' .safetensors or .json"
    card_path = path.with_suffix(".json")
    said = read_regular(card_path, what=what, most=MAX_TEXT_BYTES)
    packed = read_regular(path, what=what)
    card = read_card(said, card_type, source=card_path)
    tensors = read_safetensors(packed, what="weights are", path=path)
    net = build(card)
    load_into(net, tensors, source=path)
    return Stored(net.eval(), card, hashlib.sha256(said + packed).hexdigest())


def read_card(said: str | bytes, card_type: type[CardType], *, source: object) -> CardType:
    """Read a card.

    Raises:
        WeightsUnusableError: If it is no JSON, or has missing or extra fields.
    """
    try:
        return card_type.model_validate_json(said)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "JSON"
        raise WeightsUnusableError(
            f"weights' sidecar is not valid: {where}: {first['msg']} ({source})"
        ) from error
