"""Ranking page: cards of scenes with filters, orders and a cursor; and the same as JSON."""

import time
from collections import defaultdict
from dataclasses import dataclass
from typing import Final, cast
from urllib.parse import quote

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from schemas.errors import PermanentError
from service.curation.listing import ListedScene, ScenesRequest, passes
from service.curation.verdicts import ChoicesReply
from service.errors import UsageError
from service.web.context import render, source_of, visitor_of
from service.web.filters import JUDGED, ORDERS, WRONGS, Filters
from service.web.kept import Kept
from service.web.live import newest_of

router = APIRouter()

KEPT_S: Final = 5.0
"""Age up to which the values of the filters are used again, seconds."""

PAGE: Final = 40
"""Scenes of a page: some six screens."""


@dataclass(frozen=True, slots=True)
class Card:
    """A scene of the list, and its addresses.

    Attributes:
        scene: Its row.
        href: Address of its page, with the filters of the list and the track that passes them.
        thumbnail: Address of its picture.
        passing: Which track passes the filters, where it is not the one of the headline.
    """

    scene: ListedScene
    href: str
    thumbnail: str
    passing: str

    @property
    def kind_class(self) -> str:
        """Class of the colour of its kind."""
        return kind_class(self.scene.kind)

    @property
    def chance(self) -> float | None:
        """Probability of the attribution of its strongest track."""
        return self.scene.tracks[0].chance if self.scene.tracks else None


def kind_class(kind: str) -> str:
    """Return the class of the colour of a kind of contradiction."""
    known = ("semantic", "predictive", "witness")
    return next((f"kind-{each}" for each in known if each in kind), "kind-other")


def card_of(scene: ListedScene, filters: Filters, request: ScenesRequest) -> Card:
    """Return the card of a scene; its page opens at the track that passes the filters."""
    name = quote(scene.scene_id, safe="")
    rest = filters.query(after=None).replace("?", "&", 1)
    found = next((track for track in scene.tracks if passes(track, request)), None)
    passing = ""
    if found is None and scene.tracks:
        passing = "a weaker track passes"
    elif found is not None and found is not scene.tracks[0]:
        passing = f"track {found.track_id + 1}: {found.class_name or 'object'}, "
        passing += f"{found.range_m:.0f} m"
        rest += f"&track={found.track_id}"
    thumbnail = f"/thumb.png?id={name}&digest={quote(scene.sha256)}"
    return Card(scene, f"/scene?id={name}{rest}", thumbnail, passing)


def asked(request: Request, filters: Filters, **changes: object) -> ScenesRequest:
    """Return the listing that an address asks for."""
    most = request.query_params.get("most", "") or str(PAGE)
    if not (most.isascii() and most.isdecimal() and len(most) < 5):
        raise UsageError("most is a number of scenes, 1 to 200")
    return filters.request(
        reviewer=visitor_of(request).reviewer,
        now_s=time.clock_gettime(time.CLOCK_REALTIME),
        most=int(most),
        **changes,
    )


@router.get("/")
def ranking(request: Request) -> Response:
    """Answer with a page of the list; a filter that is not possible is named above it."""
    source, given = source_of(request), Filters.of(request.query_params)
    problem, filters = "", given
    seq, _ = newest_of(request)  # before the list: what comes later is new
    try:
        listed = asked(request, filters)
        found = source.scenes(listed)
    except PermanentError as error:
        problem, filters = str(error), Filters({})
        listed = asked(request, filters)
        found = source.scenes(listed)
    return render(
        request,
        "ranking.html",
        status=400 if problem else 200,
        section="ranking",
        problem=problem,
        cards=[card_of(scene, filters, listed) for scene in found.rows],
        total=found.total,
        is_least=found.is_least,
        next_page=filters.query(after=found.next) if found.next else "",
        first=filters.query(after=None),
        is_first="after" not in filters.given,
        given=defaultdict(str, given.given),
        chips=given.chips(),
        choices=cast(Kept[ChoicesReply], request.app.state.choices).of("", source.choices),
        orders=ORDERS,
        judged=JUDGED,
        wrongs=WRONGS,
        seq=seq,
    )


@router.get("/data/scenes")
def scenes(request: Request) -> Response:
    """Answer with a page of the list as JSON."""
    found = source_of(request).scenes(asked(request, Filters.of(request.query_params)))
    return Response(found.model_dump_json(), media_type="application/json")
