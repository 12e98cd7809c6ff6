"""Links that open the log of a scene at one second in other viewers. Pure."""

from dataclasses import dataclass
from datetime import UTC, datetime
from shlex import quote as shell_quote
from typing import Final
from urllib.parse import quote, urlencode, urlsplit

from schemas.arrays import NS_PER_S
from schemas.transport.recordings import EXTENSION

FOXGLOVE: Final = "https://app.foxglove.dev/~/view"
LICHTBLICK: Final = "https://lichtblick-suite.github.io/lichtblick/"
"""Address of Lichtblick's own page, which takes parameters at its root only."""


@dataclass(frozen=True, slots=True)
class LogLinks:
    """Ways to open a log at one second.

    Attributes:
        web: Names and addresses of viewers that open a log by its URL; empty where no browser
            reaches the log.
        commands: Command lines to copy.
        moment: The instant to seek to, RFC 3339, UTC.
        where: URL or path of the log.
    """

    web: tuple[tuple[str, str], ...]
    commands: tuple[str, ...]
    moment: str
    where: str


def rfc3339(stamp_ns: int) -> str:
    """Return an instant with nanoseconds, as RFC 3339 writes it."""
    moment = datetime.fromtimestamp(stamp_ns // NS_PER_S, tz=UTC)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{stamp_ns % NS_PER_S:09d}Z"


def links_of(bucket_url: str, log_id: str, stamp_ns: int) -> LogLinks:
    """Return the ways to open a log.

    Only an `http` or `https` bucket has links, because a viewer in the browser reads nothing else.
    A bucket of a cloud has the command that downloads the log first.

    Args:
        bucket_url: Bucket of the logs, URL or path; empty: unknown.
        log_id: Key of the log in it, without its extension. Of a split recording the name is that
            of all parts, which end in `_0`, `_1` and so on.
        stamp_ns: Instant to open, nanoseconds since the Unix epoch.
    """
    moment = rfc3339(stamp_ns)
    parts = urlsplit(bucket_url)
    key = f"{log_id}{EXTENSION}"
    name = shell_quote(key.rpartition("/")[2])
    if parts.scheme in ("http", "https"):
        where = f"{bucket_url.rstrip('/')}/{quote(key)}"
        query = urlencode({"ds": "remote-file", "ds.url": where, "time": moment})
        web = (("Foxglove", f"{FOXGLOVE}?{query}"), ("Lichtblick", f"{LICHTBLICK}?{query}"))
        fetched = f"curl -fLO {shell_quote(where)}"
        return LogLinks(web, (f"{fetched} && rerun {name}",), moment, where)
    if parts.scheme in ("s3", "gs", "az"):
        where = f"{bucket_url.rstrip('/')}/{key}"
        copy = {"s3": "aws s3 cp", "gs": "gcloud storage cp", "az": "az storage copy -s"}
        end = " -d ." if parts.scheme == "az" else " ."
        fetched = f"{copy[parts.scheme]} {shell_quote(where)}{end}"
        return LogLinks((), (f"{fetched} && rerun {name}",), moment, where)
    folder = parts.path if parts.scheme == "file" else bucket_url
    where = f"{folder.rstrip('/')}/{key}" if folder else key
    return LogLinks((), (f"rerun {shell_quote(where)}",), moment, where)
