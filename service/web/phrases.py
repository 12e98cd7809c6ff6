"""Short phrases of pages: instants, counts, shares and names of attributions. Pure."""

import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.bounds import MAX_INTEGER
from service.curation.places import text_of
from service.curation.scene_names import begins

_UNIT: Final = re.compile(r"(\d) (m/s|m|s|%)(?![\w/])")

KIND_NAMES: Final[Mapping[str, str]] = {
    "only_semantic_dynamic": "only supervised dynamic",
    "only_predictive_dynamic": "only self-supervised dynamic",
    "only_witness_dynamic": "only witness dynamic",
}
"""Names of the kinds of the task motion; kinds of other tasks have underscores replaced."""

WRONG_NAMES: Final[Mapping[str, str]] = {
    "supervised": "supervised wrong",
    "selfsupervised": "self-supervised wrong",
    "both": "both wrong",
    "neither": "neither wrong",
}

VERDICT_NAMES: Final[Mapping[str, str]] = {
    "supervised": "supervised wrong",
    "self_supervised": "self-supervised wrong",
    "both": "both wrong",
    "neither": "neither wrong",
    "unsure": "unsure",
    "duplicate": "duplicate",
    "withdrawn": "withdrawn",
}


def kind_name(kind: str) -> str:
    """Return the name of a kind of contradiction in words."""
    return KIND_NAMES.get(kind, kind.replace("_", " "))


def wrong_name(wrong: str) -> str:
    """Return an attribution in words."""
    return WRONG_NAMES.get(str(wrong), str(wrong))


def verdict_name(verdict: str) -> str:
    """Return a verdict in words."""
    return VERDICT_NAMES.get(str(verdict), str(verdict))


def instant(stamp_ns: int) -> str:
    """Return an instant in UTC, to the second."""
    return begins(stamp_ns).replace("T", " ")[:19]


def instant_of_s(stamp_s: float) -> str:
    """Return an instant given in seconds since the Unix epoch, in UTC, to the minute."""
    try:
        return datetime.fromtimestamp(stamp_s, tz=UTC).strftime("%Y-%m-%d %H:%M")
    except (OverflowError, ValueError, OSError):
        return f"{stamp_s:.0f} s"


def duration(ns: int) -> str:
    """Return a duration in seconds with one digit."""
    return f"{ns / NS_PER_S:.1f} s"


def percent(share: float, digits: int = 1) -> str:
    """Return a share as a percentage."""
    return f"{100 * share:.{digits}f} %"


def score(value: float) -> str:
    """Return a score with two digits; one that rounds to 1 but is less keeps a third."""
    return f"{value:.3f}" if 0.995 <= value < 1 else f"{value:.2f}"


def grouped(number: int) -> str:
    """Return a count with thin spaces between thousands."""
    return f"{number:,}".replace(",", "\u202f")


def counted(number: int, what: str) -> str:
    """Return a count with its noun, which gets an s unless the count is one."""
    return f"{grouped(number)} {what}" if number == 1 else f"{grouped(number)} {what}s"


def interval(share: float, low: float, high: float) -> str:
    """Return a share and its interval."""
    return f"{share:.2f} ({low:.2f} to {high:.2f})"


def scene_name(scene_id: str) -> str:
    """Return a short name of a scene by its id: last part of the log, and its begin in UTC."""
    parts = scene_id.rsplit("/", 3)
    if len(parts) < 3 or not parts[-1].isdecimal() or int(parts[-1]) > MAX_INTEGER:
        return scene_id
    return f"{parts[-3]}@{begins(int(parts[-1]))}"


def strategy_name(strategy: str) -> str:
    """Return in words by what a selection was chosen."""
    return {"best-distinct": "best distinct", "chosen": "chosen by hand"}.get(strategy, strategy)


def with_units(text: str) -> str:
    """Join each number with its unit, so that no line breaks between them."""
    return _UNIT.sub("\\1\u00a0\\2", text)


FILTERS: Final[Mapping[str, Callable[..., str]]] = {
    "kind_name": kind_name,
    "wrong_name": wrong_name,
    "verdict_name": verdict_name,
    "instant": instant,
    "instant_of_s": instant_of_s,
    "duration": duration,
    "percent": percent,
    "score": score,
    "grouped": grouped,
    "counted": counted,
    "coordinates": text_of,
    "with_units": with_units,
    "scene_name": scene_name,
    "strategy_name": strategy_name,
}
