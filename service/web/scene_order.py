"""Order of scenes around the shown one: the list it was opened from, and what is not judged yet."""

from dataclasses import dataclass
from typing import Final
from urllib.parse import quote

from schemas.score import SceneScore
from service.api.reader import Reader
from service.curation.listing import ListedScene
from service.errors import UsageError
from service.web.filters import Filters

MOST_LISTED: Final = 60
"""Scenes of the list that are searched for the shown one."""

_NO_CURSOR: Final = {"after": None}


@dataclass(frozen=True, slots=True)
class Order:
    """Addresses of other scenes of the list; empty where there is none.

    Attributes:
        next: The next scene of the list.
        previous: The one before.
        unjudged: The next one that the reviewer has not judged.
        total: Scenes of the list.
        place: Place of this scene among the first ones of the list, from 1; None if it is beyond.
    """

    next: str = ""
    previous: str = ""
    unjudged: str = ""
    total: int = 0
    place: int | None = None


def order_of(
    source: Reader, score: SceneScore, filters: Filters, *, reviewer: str, now_s: float
) -> Order:
    """Find the scenes around one in the list that its address describes."""
    rest = filters.query(**_NO_CURSOR)

    def rows(**changes: object) -> tuple[tuple[ListedScene, ...], int]:
        asked = filters.request(
            reviewer=reviewer, now_s=now_s, most=MOST_LISTED, **{"after": "", **changes}
        )
        found = source.scenes(asked)
        return found.rows, found.total

    try:
        listed, total = rows()
        own = _index(listed, score.scene_id)
        if own is None and filters.given.get("sort", "score") == "score":
            listed, _ = rows(max_score=score.score)
            below = _index(listed, score.scene_id)
            following = listed[below + 1 :] if below is not None else ()
            previous: tuple[ListedScene, ...] = ()
        else:
            following = listed[own + 1 :] if own is not None else listed
            previous = listed[:own] if own is not None else ()
        unjudged = next((row for row in following if _waits(row, reviewer)), None)
        if unjudged is None or unjudged.verdicts.tracks:  # its tracks may be this reviewer's
            waiting, _ = rows(judged="not_mine" if reviewer else "no")
            ids = {row.scene_id for row in waiting} - {score.scene_id}
            is_all = len(waiting) < MOST_LISTED
            after = [
                row
                for row in following
                if row.scene_id in ids or (not is_all and _waits(row, reviewer))
            ]
            before = [row for row in (*previous, *waiting) if row.scene_id in ids]
            unjudged = next(iter((*after, *before)), None)
    except UsageError:
        return Order()
    return Order(
        next=href_of(following[0].scene_id, rest) if following else "",
        previous=href_of(previous[-1].scene_id, rest) if previous else "",
        unjudged=href_of(unjudged.scene_id, rest) if unjudged else "",
        total=total,
        place=None if own is None else own + 1,
    )


def href_of(scene_id: str, query: str = "") -> str:
    """Return the address of a scene's page, with the filters of the list it is opened from."""
    return f"/scene?id={quote(scene_id, safe='')}{query.replace('?', '&', 1)}"


def _waits(row: ListedScene, reviewer: str) -> bool:
    """Return true for a scene without a verdict of this reviewer; without a name: of anybody."""
    return row.verdicts.mine is None if reviewer else not row.verdicts.judged


def _index(rows: tuple[ListedScene, ...], scene_id: str) -> int | None:
    return next((at for at, row in enumerate(rows) if row.scene_id == scene_id), None)
