"""Docstrings, pages and the texts of the command line keep the rule for sentences."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from service.cli.main import app_of
from tests.architecture.sentences import (
    CODE,
    ROOT,
    Breach,
    breaches_of_code,
    breaches_of_page,
    breaches_of_text,
    files_of_code,
    pages,
)

ROOMS = ("", *CODE)
"""First folder of a page; empty for the pages of the root."""


@pytest.mark.parametrize("room", CODE)
def test_docstrings_keep_the_rule_for_sentences(room: str) -> None:
    files = [path for path in files_of_code() if _room_of(path) == room]
    assert files, room
    _require_none(breach for path in files for breach in breaches_of_code(path))


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room or "root")
def test_pages_keep_the_rule_for_sentences(room: str) -> None:
    found = [path for path in pages() if _room_of(path) == room]
    assert found, room
    _require_none(breach for path in found for breach in breaches_of_page(path))


def test_texts_of_the_command_line_keep_the_rule_for_sentences() -> None:
    texts = list(_texts_of_the_command_line())
    assert len(texts) > 100
    _require_none(breach for where, text in texts for breach in breaches_of_text(text, where))


@pytest.mark.parametrize(
    "text",
    [
        "Whoever asks waits.",
        "It is mined anew.",
        "The stream says that it moves.",
        "A thing beside the street, as it was seen.",
        "word " * 31,
    ],
)
def test_the_rule_finds_what_it_denies(text: str) -> None:
    assert list(breaches_of_text(text, "here"))


@pytest.mark.parametrize(
    "text",
    [
        "Return the scenes of a log, best first.",
        "bucket ─► ledger " + "─► whoever " * 40,
        "Rerun `counterpoint beside` once the disk has room.",
    ],
)
def test_the_rule_finds_nothing_in_plain_sentences_drawings_and_code(text: str) -> None:
    assert list(breaches_of_text(text, "here")) == []


def _room_of(path: Path) -> str:
    first, *others = path.relative_to(ROOT).parts
    return first if others else ""


def _texts_of_the_command_line() -> Iterator[tuple[str, str]]:
    waiting = [("counterpoint", typer.main.get_command(app_of()))]
    while waiting:
        name, command = waiting.pop()
        verbs = getattr(command, "commands", {})
        waiting += [(f"{name} {verb}", below) for verb, below in verbs.items()]
        yield name, str(getattr(command, "help", "") or "")
        for parameter in command.params:
            help_text = str(getattr(parameter, "help", "") or "")
            yield f"{name} {parameter.name}", help_text


def _require_none(breaches: Iterator[Breach]) -> None:
    listed = [str(breach) for breach in breaches]
    assert listed == [], "\n".join(listed)
