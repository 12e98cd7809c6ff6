"""Options shared by several verbs, and the settings made from them."""

import textwrap
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from schemas.runtime.process import log_to_stderr
from service.cli.output import remark_as_events
from service.settings.config import Settings, load_settings
from workers.parts.catalogue import parts_of_kind
from workers.parts.part import PartSetting

MOST: Final = 1_000_000_000
"""Largest count of any option; it exceeds every fleet, and fits a database column."""

_HELP_WIDTH: Final = 50
"""Columns for help texts, right of the option names, on a terminal of 80 columns."""


def _choice_of(setting: PartSetting, what: str) -> str:
    """Describe the choice of an option, and below it each accepted name with its line."""
    lines = [f"{what}, one of:"]
    for part in parts_of_kind(setting):
        lines.append(part.name)
        lines += textwrap.wrap(
            part.text,
            _HELP_WIDTH,
            initial_indent="  ",
            subsequent_indent="  ",
            break_on_hyphens=False,
        )
    return "\b\n" + "\n".join(lines)


Config = Annotated[
    Path | None,
    typer.Option(
        "--config",
        help="TOML file of settings, else COUNTERPOINT_CONFIG; variables and flags win over it.",
    ),
]
BucketOfLogs = Annotated[str, typer.Argument(help="URL or path of a bucket of logs.")]
BucketUrl = Annotated[
    str | None,
    typer.Option("--bucket", help="URL or path of the log bucket, else COUNTERPOINT_BUCKET."),
]
BucketRoot = Annotated[
    str | None,
    typer.Option("--bucket", help="Root that log_id is relative to, else COUNTERPOINT_BUCKET."),
]
StateDir = Annotated[
    Path | None, typer.Option("--state", help="Folder of ledger and overlays; counterpoint-state.")
]
StateToRead = Annotated[
    Path | None, typer.Option("--state", help="Folder of a run; no daemon is needed then.")
]
Database = Annotated[
    str | None,
    typer.Option("--database", help="URL of a PostgreSQL instead of SQLite in the state folder."),
]
Artifacts = Annotated[
    str | None,
    typer.Option("--artifacts", help="URL for overlays; the folder artifacts in the state."),
]
Connect = Annotated[
    str | None, typer.Option("--connect", help="tcp/HOST:PORT of the router; commas for several.")
]
Supervised = Annotated[
    str | None,
    typer.Option("--supervised", help=_choice_of("supervised", "Supervised stream")),
]
Model = Annotated[
    str | None,
    typer.Option("--model", help="Your own model: its adapter.toml."),
]
Weights = Annotated[
    str | None,
    typer.Option("--weights", help="Folder of imported weights; those that ship."),
]
Predictions = Annotated[
    str | None,
    typer.Option(
        "--predictions",
        help="Folder or bucket with the model's answer next to the logs: .label or Parquet.",
    ),
]
Odometry = Annotated[
    str | None, typer.Option("--odometry", help=_choice_of("odometry", "Odometry"))
]
Camera = Annotated[
    str | None,
    typer.Option("--camera", help="Whose view is compared: recorded, or a JSON calibration."),
]
PresetName = Annotated[
    str | None,
    typer.Option("--preset", help="Settings that belong together: default, or paper."),
]
SelfSupervised = Annotated[
    str | None,
    typer.Option(
        "--selfsupervised",
        help=_choice_of("selfsupervised", "Self-supervised stream"),
    ),
]
ShardSeconds = Annotated[
    float | None,
    typer.Option("--shard-seconds", help="Length of a shard's window, whole scenes; 20."),
]
Include = Annotated[
    list[str] | None,
    typer.Option(
        "--include", help="Only keys that match this pattern; * also crosses /. Repeatable."
    ),
]
Exclude = Annotated[
    list[str] | None,
    typer.Option("--exclude", help="No key that matches this pattern. Repeatable."),
]
LogFormat = Annotated[
    str | None,
    typer.Option("--log-format", help="Log lines for people or for machines: console, json."),
]
LogLevel = Annotated[
    str | None,
    typer.Option("--log-level", help="Least level that is logged: debug, info, warning, error."),
]
Force = Annotated[
    bool,
    typer.Option("--force", help="Replace a file there even if counterpoint did not write it."),
]
Json = Annotated[bool, typer.Option("--json", help="JSON lines on stdout.")]


def settings_for(config: Path | None, **flags: Any) -> Settings:
    """Read the settings of a verb, and configure logging from them.

    Args:
        config: Value of `--config`.
        flags: Flags as `service.settings.config.read_settings` takes them; an empty list counts as
            not given.

    Raises:
        UsageError: If a name is unknown or a value impossible.
    """
    given = {name: value for name, value in flags.items() if value != []}
    settings = load_settings(config=config, **given)
    log_as(settings, is_daemon="log_format" in flags)
    return settings


def log_as(settings: Settings, *, is_daemon: bool) -> None:
    """Configure logs and remarks from the settings.

    Args:
        settings: Settings of a verb; one file serves daemons and interactive verbs.
        is_daemon: True to use their format too; an interactive verb always writes plain text.
    """
    as_json = is_daemon and settings.log_format == "json"
    log_to_stderr(level=settings.log_level, as_json=as_json)
    remark_as_events(as_json)
