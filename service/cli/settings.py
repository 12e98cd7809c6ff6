"""Verbs on the installation: `config` shows the settings, `doctor` checks them."""

import typer

from service.cli.option_groups import MiningOptions, grouped
from service.cli.options import (
    Artifacts,
    BucketUrl,
    Config,
    Connect,
    Database,
    Json,
    StateDir,
    log_as,
)
from service.cli.output import json_line, progress, remark, table
from service.settings.config import read_settings
from service.settings.hidden_passwords import shown
from service.settings.table import setting_rows


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    app.command(name="config", epilog="counterpoint config --config fleet.toml")(print_settings)
    app.command(epilog="counterpoint doctor --config fleet.toml")(doctor)


@grouped
def print_settings(
    *,
    mining: MiningOptions,
    config: Config = None,
    json: Json = False,
) -> None:
    """Print every setting with its value and the source of that value."""
    read = read_settings(
        config=config,
        **mining.flags(),
    )
    log_as(read.settings, is_daemon=False)
    rows = list(setting_rows(read))
    if json:
        for row in rows:
            json_line(row)
        return
    table(
        "settings",
        ("setting", "value", "from", "mined again", "meaning"),
        (
            (
                row.setting,
                shown(row.value),
                row.origin,
                "yes" if row.in_pipeline_version else None,
                row.description,
            )
            for row in rows
        ),
    )
    file = f"the file {read.file}" if read.file else "a file (--config; none is read now)"
    remark(
        f"flags win over COUNTERPOINT_* variables, these over {file}; when a setting with "
        "`mined again` changes, everything in the bucket is mined again"
    )


@grouped
def doctor(
    *,
    bucket: BucketUrl = None,
    state: StateDir = None,
    connect: Connect = None,
    artifacts: Artifacts = None,
    database: Database = None,
    mining: MiningOptions,
    config: Config = None,
    json: Json = False,
) -> None:
    """Check settings, bucket, artifacts, state, bus and workers; print remedies for problems."""
    from service.doctor.examination import examine

    read = read_settings(
        config=config,
        bucket=bucket,
        state=state,
        connect=connect,
        artifacts=artifacts,
        database=database,
        **mining.flags(),
    )
    log_as(read.settings, is_daemon=False)
    findings = []
    with progress() as bar:
        task = bar.add_task("examining", total=None)
        for finding in examine(read):
            findings.append(finding)
            bar.update(task, description=f"examined {finding.what}")
            if json:
                json_line(finding)
    if not json:
        table(
            "doctor",
            ("what", "verdict", "found"),
            ((each.what, each.verdict, each.says) for each in findings),
        )
    problems = sum(each.verdict == "problem" for each in findings)
    warnings = sum(each.verdict == "warning" for each in findings)
    remark(f"problems: {problems}, warnings: {warnings}")
    if problems:
        raise typer.Exit(1)
