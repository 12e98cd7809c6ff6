"""Verb `bench viewer`: what a reviewer waits for on the page of a scene, each with its bound."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from service.api.reader import Reader
from service.cli.options import Config, Json, StateToRead
from service.cli.output import json_line, progress, remark, table
from service.cli.scenes import reader
from service.errors import UsageError

if TYPE_CHECKING:
    from service.web.bench_viewer import Figure

NEEDS: Final = (
    "bench viewer drives Debian's chromium by Playwright: pip install 'counterpoint[dev,review]' "
    "and apt-get install chromium ({} is missing)"
)


def viewer(
    scene: Annotated[
        str | None, typer.Argument(help="Id of a scene; none: the best one of the state.")
    ] = None,
    state: StateToRead = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Measure the page of a scene in Chromium: paint, orbit, scrub, memory, bytes, isolation."""
    from service.cli.review import need_extra

    need_extra()
    try:
        from service.web.bench_viewer import CHROMIUM, bench_viewer
    except ModuleNotFoundError as error:
        raise UsageError(NEEDS.format(error.name)) from None
    if not Path(CHROMIUM).exists():
        raise UsageError(NEEDS.format(CHROMIUM))
    source = reader(config, connect=None, state=state, database=None)
    scene_id = scene or _best(source)
    rows = []
    with progress() as bar:
        task = bar.add_task("measuring", total=None)
        for row in bench_viewer(source, scene_id):
            rows.append(row)
            bar.update(task, advance=1)
    if json:
        for row in rows:
            json_line(asdict(row))
        return
    table(
        f"{scene_id}: page of the scene",
        ("figure", "measured", "bound", "held"),
        (
            (
                row.name,
                f"{row.value:.1f} {row.unit}".strip(),
                _bound(row),
                "yes" if row.is_held else "NO",
            )
            for row in rows
        ),
    )
    bounded = [row for row in rows if row.bound is not None]
    remark(f"{sum(row.is_held for row in bounded)} of {len(bounded)} bounds are held")


def _bound(row: "Figure") -> str:
    if row.bound is None:
        return ""
    return f"{'at least' if row.at_least else 'at most'} {row.bound:.0f} {row.unit}".strip()


def _best(source: Reader) -> str:
    rows = source.top(1)
    if not rows:
        raise UsageError("this state has no scene: name another one with --state")
    return rows[0].scene_id
