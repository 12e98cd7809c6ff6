"""Filters of a listing, as the address of a page holds them. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import urlencode

from pydantic import ValidationError

from schemas.attribution import Wrong
from schemas.transport.wire import first_problem
from service.curation.listing import JudgedFilter, SceneOrder, ScenesRequest
from service.curation.rates import rates_request
from service.errors import UsageError
from service.web.phrases import kind_name, wrong_name

FIELDS: Final[Mapping[str, str]] = {
    "vehicle": "vehicle",
    "version": "software_version",
    "kind": "kind",
    "class": "class_name",
    "wrong": "wrong",
    "mode": "mode",
    "beyond": "beyond_m",
    "within": "within_m",
    "min": "min_score",
    "max": "max_score",
    "judged": "judged",
    "log": "log",
    "q": "text",
    "selection": "selection",
    "sort": "sort",
    "after": "after",
}
"""Parameters of an address, and the fields of the request that they are; `since` and `until` are
parsed first.
"""

TIMES: Final = ("since", "until")

NOT_FILTERS: Final = frozenset({"sort", "after"})

TITLES: Final[Mapping[str, str]] = {
    "vehicle": "vehicle",
    "version": "version",
    "kind": "kind",
    "class": "class",
    "wrong": "attribution",
    "mode": "stream",
    "beyond": "range beyond",
    "within": "range within",
    "since": "since",
    "until": "until",
    "min": "score at least",
    "max": "score at most",
    "judged": "judged",
    "log": "log",
    "q": "text",
    "selection": "selection",
}

ORDERS: Final[Mapping[SceneOrder, str]] = {
    "score": "Best first",
    "newest": "Newest first",
    "latest": "Latest recording",
    "earliest": "Earliest recording",
    "judged": "Last judged",
}

JUDGED: Final[Mapping[JudgedFilter, str]] = {
    "any": "All",
    "no": "Not judged",
    "yes": "Judged",
    "not_mine": "Not by me",
    "mine": "By me",
}

MAX_VALUE: Final = 4096


@dataclass(frozen=True, slots=True)
class Filters:
    """Values of an address that are not empty, by their parameter."""

    given: Mapping[str, str]

    @classmethod
    def of(cls, query: Mapping[str, str]) -> "Filters":
        """Take what an address names, and leave out what it does not know.

        Raises:
            UsageError: If a value is too long.
        """
        known = {
            name: query[name].strip() for name in (*FIELDS, *TIMES) if query.get(name, "").strip()
        }
        for name, value in known.items():
            if len(value) > MAX_VALUE:
                raise UsageError(f"{name} is longer than {MAX_VALUE} characters")
        return cls(known)

    def request(self, *, reviewer: str, now_s: float, most: int, **changes: Any) -> ScenesRequest:
        """Return the request of these filters.

        Args:
            reviewer: The person who asks; empty: unknown, and filters by `mine` are refused.
            now_s: Time from which an age such as `7d` counts back, seconds since the Unix epoch.
            most: Rows of the page.
            changes: Fields of the request that replace those of the address.

        Raises:
            UsageError: If a value is impossible; the message names it.
        """
        since, until = (self.given.get(name, "") for name in TIMES)
        times = rates_request("vehicle", since=since, until=until, now_s=now_s)
        if not reviewer and self.given.get("judged") in ("mine", "not_mine"):
            raise UsageError("whose verdicts: give your name first, at the top of the page")
        fields: dict[str, Any] = {
            FIELDS[name]: value for name, value in self.given.items() if name in FIELDS
        }
        fields |= {
            "since_ns": times.since_ns or None,
            "until_ns": times.until_ns,
            "reviewer": reviewer or None,
            "most": most,
        }
        try:
            return ScenesRequest.model_validate(fields | changes)
        except ValidationError as error:
            field, _, problem = first_problem(error).partition(": ")
            titles = {FIELDS[name]: title for name, title in TITLES.items() if name in FIELDS}
            raise UsageError(
                f"this filter is not possible: {titles.get(field, field)}: {problem}"
            ) from None

    def query(self, **changes: str | None) -> str:
        """Return the query of an address with these filters and changes; empty without any."""
        changed = {name: value for name, value in {**self.given, **changes}.items() if value}
        return f"?{urlencode(changed)}" if changed else ""

    def chips(self) -> list[tuple[str, str]]:
        """Return a phrase for each filter in effect, and the query without it."""
        return [
            (f"{TITLES[name]}: {_shown(name, value)}", self.query(**{name: None, "after": None}))
            for name, value in self.given.items()
            if name not in NOT_FILTERS and not (name == "judged" and value == "any")
        ]


def _shown(name: str, value: str) -> str:
    if name == "kind":
        return kind_name(value)
    if name == "wrong":
        return wrong_name(value)
    if name == "judged":
        return next((title for given, title in JUDGED.items() if given == value), value).lower()
    if name in ("beyond", "within"):
        return f"{value} m"
    return value


WRONGS: Final = tuple(each.value for each in Wrong)
