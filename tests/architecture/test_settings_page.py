"""The page of settings is what the program says, and every setting says what it is for."""

from pathlib import Path

import typer

from service.cli.main import app_of
from service.cli.settings_page import made_page
from service.settings.config import NOT_IN_VERSION, ReadSettings, Settings
from service.settings.table import setting_rows
from workers import version

PAGE = Path(__file__).resolve().parents[2] / "deploy" / "SETTINGS.md"


def test_the_page_of_settings_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == made_page(), (
        "a setting or flag changed: run `python -m service.cli.settings_page > deploy/SETTINGS.md`"
    )


def test_every_setting_says_what_it_is_for() -> None:
    rows = list(setting_rows(ReadSettings(Settings(), {}, None)))
    assert len(rows) > 20
    assert [row.setting for row in rows if not row.description] == []
    assert [row.setting for row in rows if not row.description.endswith((".", ")"))] == []


def test_what_is_said_to_be_mined_anew_is_what_the_pipeline_version_digests() -> None:
    assert NOT_IN_VERSION == version.NOT_IN_VERSION


def test_every_option_of_every_verb_has_a_help_and_every_verb_an_example() -> None:
    silent = []
    waiting = [("counterpoint", typer.main.get_command(app_of()))]
    while waiting:
        name, command = waiting.pop()
        verbs = getattr(command, "commands", {})
        waiting += [(f"{name} {verb}", below) for verb, below in verbs.items()]
        if not verbs and not str(getattr(command, "epilog", "")).startswith("counterpoint "):
            silent.append(name)
        silent += [
            f"{name} {parameter.name}"
            for parameter in command.params
            if not getattr(parameter, "help", None) and parameter.name != "help"
        ]
    assert silent == []
