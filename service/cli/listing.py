"""Filters of `top`, and the scenes that pass them, page by page."""

from dataclasses import dataclass, fields
from typing import Annotated, Any, Final

import typer

from schemas.attribution import Wrong
from service.api.messages import checked_request
from service.api.reader import Reader
from service.cli.output import counted, json_line, listing, remark
from service.curation.listing import MAX_PAGE, ListedScene, ScenesRequest
from service.curation.ranges import MAX_BOUND_M
from service.curation.rates import instants_ns

MOST_CLASSES: Final = 20
"""Classes that are named where a filter by class finds nothing."""

_FILTER: Final = "Filters"


def _option(*names: str, help_: str, **how: Any) -> Any:
    return typer.Option(*names, help=help_, rich_help_panel=_FILTER, **how)


@dataclass(frozen=True, slots=True, kw_only=True)
class ListingOptions:
    """Filters of scenes; a scene passes all that are given."""

    vehicle: Annotated[str | None, _option("--vehicle", help_="Only this vehicle.")] = None
    software_version: Annotated[
        str | None, _option("--software-version", help_="Only this software version of the car.")
    ] = None
    kind: Annotated[
        str | None,
        _option(
            "--kind",
            help_="Only scenes with a strong track of this kind: `rates --by kind` lists them.",
        ),
    ] = None
    class_name: Annotated[
        str | None,
        _option("--class", help_="Only scenes with a strong track of this class, in any case."),
    ] = None
    wrong: Annotated[
        Wrong | None, _option("--wrong", help_="Only scenes with this attribution of a track.")
    ] = None
    mode: Annotated[
        str | None, _option("--mode", help_="Only this supervised stream, name or name@version.")
    ] = None
    beyond_m: Annotated[
        int | None,
        _option(
            "--beyond",
            help_="Only scenes with a strong track beyond this range, metres.",
            min=0,
            max=MAX_BOUND_M,
        ),
    ] = None
    within_m: Annotated[
        int | None,
        _option(
            "--within",
            help_="Only scenes with a strong track within this range, metres.",
            min=1,
            max=MAX_BOUND_M,
        ),
    ] = None
    since: Annotated[
        str, _option("--since", help_="Recorded at or after: a date, a time, or 24h, 7d.")
    ] = ""
    until: Annotated[str, _option("--until", help_="Recorded before; as --since.")] = ""
    min_score: Annotated[
        float | None, _option("--min-score", help_="Least score.", min=0, max=1)
    ] = None
    max_score: Annotated[
        float | None, _option("--max-score", help_="Highest score.", min=0, max=1)
    ] = None
    judged: Annotated[
        str | None,
        _option("--judged", help_="yes, no, or by --reviewer: mine, not_mine."),
    ] = None
    reviewer: Annotated[
        str | None, _option("--reviewer", help_="Reviewer of --judged mine and not_mine.")
    ] = None
    log: Annotated[
        str | None, _option("--log", help_="Only logs whose id matches; * also crosses /.")
    ] = None
    text: Annotated[
        str, _option("--text", help_="Part of the scene's id or headlines, in any case.")
    ] = ""
    selection: Annotated[
        str | None, _option("--selection", help_="Only scenes of this selection.")
    ] = None
    sort: Annotated[
        str | None,
        _option("--sort", help_="score, newest, earliest, latest, or judged: last judged first."),
    ] = None

    def any_given(self) -> bool:
        """Return true if a filter or an order is given."""
        return any(getattr(self, each.name) not in (None, "") for each in fields(self))

    def request(self, *, now_s: float) -> ScenesRequest:
        """Return the request for the first page.

        Raises:
            UsageError: If a value is invalid; the message names it.
        """
        since_ns, until_ns = instants_ns(since=self.since, until=self.until, now_s=now_s)
        given = {
            each.name: getattr(self, each.name)
            for each in fields(self)
            if each.name not in {"since", "until"} and getattr(self, each.name) is not None
        }
        return checked_request(
            ScenesRequest, **given, since_ns=since_ns or None, until_ns=until_ns, most=MAX_PAGE
        )


def listed(
    source: Reader, request: ScenesRequest, *, most: int | None
) -> tuple[list[ListedScene], str]:
    """Read page after page; return the first `most` scenes, None: all, and how many pass."""
    rows: list[ListedScene] = []
    while True:
        left = MAX_PAGE if most is None else min(MAX_PAGE, most - len(rows))
        page = source.scenes(request.model_copy(update={"most": left}))
        rows += page.rows
        if not page.next or (most is not None and len(rows) >= most):
            return rows, f"{'over ' if page.is_least else ''}{counted(page.total, 'scene')}"
        request = request.model_copy(update={"after": page.next})


def say_classes(source: Reader) -> None:
    """Print the classes of strong tracks, where a filter by class found nothing."""
    names = source.choices().class_names
    more = len(names) - MOST_CLASSES
    listed_names = ", ".join(names[:MOST_CLASSES]) + (f" and {more} more" if more > 0 else "")
    remark(f"classes of strong tracks: {listed_names or 'none has one'}")


def say_listed(rows: list[ListedScene], total: str, *, json: bool) -> None:
    """Print scenes that pass the filters, each with its headline below."""
    if json:
        for row in rows:
            json_line(row)
        return
    listing(
        f"{len(rows)} of {total}",
        ("score", "seconds", "vehicle", "verdicts", "scene"),
        (
            (
                (
                    row.score,
                    f"{(row.end_ns - row.start_ns) / 1e9:.1f}",
                    row.vehicle,
                    row.verdicts.text or None,
                    row.scene_id,
                ),
                row.headline,
            )
            for row in rows
        ),
    )
    if not rows:
        remark("no scene passes; `rates --by kind`, `vehicle` or `version` lists what there is")
