"""A listing of the bucket with single objects changed, and the logs that this concerns. Pure."""

import re
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from schemas.transport.bucket import ObjectMeta
from schemas.transport.recordings import EXTENSION, group_recordings
from schemas.work import Recording

_NUMBERS: Final = re.compile(r"(_[0-9]+)+$")


@dataclass(frozen=True, slots=True)
class ChangedObjects:
    """A listing after single objects have changed.

    Attributes:
        objects: All objects, in the order of their keys.
        recordings: Present recordings of the logs that may have changed.
        log_ids: Ids of these logs, before and now.
    """

    objects: Sequence[ObjectMeta]
    recordings: Sequence[Recording]
    log_ids: frozenset[str]


def with_objects(
    before: Sequence[ObjectMeta], found: Mapping[str, ObjectMeta | None]
) -> ChangedObjects:
    """Put single objects into a listing.

    Parts of a split log belong together by their names. So all objects are grouped again whose
    names begin like that of a changed one without its numbers.

    Args:
        before: A listing, in the order of its keys.
        found: Objects by key; None: there is none.
    """
    objects = list(before)
    for key in sorted(found):
        at = bisect_left(objects, key, key=_key)
        there = at < len(objects) and objects[at].key == key
        objects[at : at + there] = [each] if (each := found[key]) is not None else []
    roots = {_NUMBERS.sub("", key.removesuffix(EXTENSION)) for key in found}
    then, now = (_grouped(listing, roots) for listing in (before, objects))
    return ChangedObjects(objects, tuple(now.values()), frozenset(then.keys() | now.keys()))


def _grouped(listing: Sequence[ObjectMeta], roots: set[str]) -> dict[str, Recording]:
    near: dict[str, ObjectMeta] = {}
    for root in roots:
        at = bisect_left(listing, root, key=_key)
        while at < len(listing) and listing[at].key.startswith(root):
            near[listing[at].key] = listing[at]
            at += 1
    return {each.log_id: each for each in group_recordings(near.values())}


def _key(found: ObjectMeta) -> str:
    return found.key
