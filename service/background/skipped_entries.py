"""Entries of a bucket that are no logs, and that no pattern of the settings leaves out."""

from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from itertools import chain, islice

from schemas.transport.bucket import ObjectMeta
from schemas.transport.folder import Skipped
from schemas.transport.recordings import EXTENSION
from schemas.visible import visible
from service.curation.status import MAX_NAMED, SkippedEntries, SkippedEntry


def is_wanted(key: str, *, include: Sequence[str], exclude: Sequence[str]) -> bool:
    """Return true if a key matches a pattern to include, if any, and none to exclude."""
    included = not include or any(fnmatchcase(key, each) for each in include)
    return included and not any(fnmatchcase(key, each) for each in exclude)


def skipped_among(
    objects: Iterable[ObjectMeta],
    unlisted: Iterable[Skipped],
    *,
    include: Sequence[str],
    exclude: Sequence[str],
) -> SkippedEntries:
    """Name the first entries that are no logs, and count all of them.

    Args:
        objects: Listed objects of the bucket.
        unlisted: Entries that could not be listed; they come first.
        include: Patterns of keys that count; empty: all.
        exclude: Patterns of keys that do not count.
    """
    names = sorted((each.name, each.why) for each in unlisted)
    others = [
        each.key
        for each in objects
        if not each.key.endswith(EXTENSION)
        and is_wanted(each.key, include=include, exclude=exclude)
    ]
    entries = chain(names, ((visible(key), f"is no {EXTENSION} file") for key in others))
    return SkippedEntries(
        count=len(names) + len(others),
        named=tuple(SkippedEntry(name=name, why=why) for name, why in islice(entries, MAX_NAMED)),
    )
