"""Verb `parts`: which parts can be chosen, where they come from, and what weights they need."""

import typer

from service.cli.options import Json
from service.cli.output import json_line, remark, table


def add_to(app: typer.Typer) -> None:
    """Add the verb of this file to the command."""
    app.command(epilog="counterpoint parts --json")(parts)


def parts(json: Json = False) -> None:
    """List the replaceable parts: source, licence, weights; which are the default."""
    from workers.parts import part_cards

    cards = part_cards()
    if json:
        for card in cards:
            json_line(card)
        return
    table(
        "replaceable parts",
        ("setting", "name", "", "what it does", "source", "licence", "weights"),
        (
            (
                card.part,
                card.name,
                "default" if card.default else "paper" if card.paper else "",
                card.what,
                card.source,
                card.licence,
                card.weights,
            )
            for card in cards
        ),
    )
    remark("choose one by its setting: --supervised NAME, COUNTERPOINT_SUPERVISED, or in the TOML")
