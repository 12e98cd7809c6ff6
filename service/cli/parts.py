"""Verb `parts`: the replaceable parts, their sources and the weights they need."""

from typing import TYPE_CHECKING

import typer

from service.cli.options import Json
from service.cli.output import json_line, remark, table
from service.settings.presets import PRESETS

if TYPE_CHECKING:
    from workers.parts.catalogue import PartCard


def add_to(app: typer.Typer) -> None:
    """Add the verb of this file to the command."""
    app.command(epilog="counterpoint parts --json")(parts)


def parts(json: Json = False) -> None:
    """List the replaceable parts: source, licence, weights; which are the default."""
    from workers.parts.catalogue import part_cards

    cards = part_cards()
    if json:
        for card in cards:
            json_line({**card.model_dump(mode="json"), "presets": presets_with(card)})
        return
    about = ("what it does", "source", "licence", "weights")
    table(
        "replaceable parts",
        ("setting", "name", "", *about),
        (
            (card.part, card.name, _marks(card), card.what, card.source, card.licence, card.weights)
            for card in cards
            if card.part != "network"
        ),
    )
    table(
        "networks of these parts, whose weights are imported",
        ("network", *about),
        (
            (card.name, card.what, card.source, card.licence, card.weights)
            for card in cards
            if card.part == "network"
        ),
    )
    remark(
        "choose a part by its setting: --supervised NAME, COUNTERPOINT_SUPERVISED, or in the TOML"
    )
    remark("paper: part of the paper's method; preset paper: chosen by --preset paper")


def presets_with(card: "PartCard") -> list[str]:
    """Return the presets that choose a part; `default` is marked separately."""
    return [name for name, settings in PRESETS.items() if settings.get(card.part) == card.name]


def _marks(card: "PartCard") -> str:
    marks = ["default"] * card.default + ["paper"] * card.paper
    return ", ".join(marks + [f"preset {name}" for name in presets_with(card)])
