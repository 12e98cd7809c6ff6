"""Options that filter current scenes, the same ones for every verb that takes them."""

from dataclasses import dataclass, fields
from typing import Annotated

import typer

from service.api.messages import checked_request
from service.curation.listing import ScenesRequest
from service.curation.ranges import MAX_BOUND_M
from service.curation.rates import rates_request


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneFilters:
    """Options of every verb that filters scenes; what is not given lets everything pass."""

    vehicle: Annotated[
        str | None, typer.Option("--vehicle", help="Only scenes of this vehicle.")
    ] = None
    software_version: Annotated[
        str | None,
        typer.Option("--software-version", help="Only of vehicles that ran this software."),
    ] = None
    since: Annotated[
        str, typer.Option("--since", help="Only recorded at or after: a date, a time, or 24h, 7d.")
    ] = ""
    until: Annotated[str, typer.Option("--until", help="Only recorded before: as --since.")] = ""
    kind: Annotated[
        str | None,
        typer.Option(
            "--kind", help="Only with a strong track of this kind: `rates --by kind` lists them."
        ),
    ] = None
    class_name: Annotated[
        str | None,
        typer.Option("--class", help="Only with a strong track of this class, in any case."),
    ] = None
    wrong: Annotated[
        str | None,
        typer.Option(
            "--wrong",
            help="Only with a strong track on which this stream errs: supervised, selfsupervised, "
            "both or neither.",
        ),
    ] = None
    beyond_m: Annotated[
        int | None,
        typer.Option(
            "--beyond",
            min=0,
            max=MAX_BOUND_M,
            help="Only with a strong track beyond this range, metres.",
        ),
    ] = None
    within_m: Annotated[
        int | None,
        typer.Option(
            "--within",
            min=1,
            max=MAX_BOUND_M,
            help="Only with a strong track within this range, metres.",
        ),
    ] = None
    judged: Annotated[
        str, typer.Option("--judged", help="By verdicts of reviewers: any, yes or no.")
    ] = "any"

    def request(self, *, now_s: float) -> ScenesRequest | None:
        """Return the filters that were given; None without any.

        Args:
            now_s: Time from which an age counts back, seconds since the Unix epoch.

        Raises:
            UsageError: If a value is invalid; the message names it.
        """
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        since, until = given.pop("since"), given.pop("until")
        if since or until:
            times = rates_request("vehicle", since=since, until=until, now_s=now_s)
            given |= {"since_ns": times.since_ns or None, "until_ns": times.until_ns}
        asked = checked_request(ScenesRequest, **given)
        return None if asked == ScenesRequest() else asked
