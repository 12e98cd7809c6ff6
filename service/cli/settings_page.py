"""Page of the settings: each with its default, bounds, flag and meaning."""

import typer

from service.cli.main import app_of
from service.cli.output import page
from service.settings.table import settings_page


def made_page() -> str:
    """Return the page, with the flags of every verb."""
    return settings_page(flags_of(typer.main.get_command(app_of())))


def flags_of(command: object) -> set[str]:
    """Collect the flags of a command and of every verb below it."""
    found = {
        option
        for parameter in getattr(command, "params", ())
        for option in parameter.opts
        if option.startswith("--")
    }
    return found.union(*map(flags_of, getattr(command, "commands", {}).values()))


if __name__ == "__main__":
    page(made_page())
