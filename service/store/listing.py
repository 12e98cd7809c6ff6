"""Pages of the listing: current scenes by filter and order, from narrow rows and indexes."""

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Final

from sqlalchemy import (
    ColumnElement,
    Connection,
    FromClause,
    and_,
    bindparam,
    func,
    or_,
    select,
    tuple_,
)

from schemas.arrays import NS_PER_S
from schemas.events import MAX_LISTED_TRACKS, TrackSummary
from schemas.score import MIN_REPORTED_STRENGTH, SceneScore
from schemas.transport.wire import decode
from schemas.verdict import VerdictSummary
from service.curation.listing import (
    MOST_COUNTED,
    ListedScene,
    SceneOrder,
    ScenesReply,
    ScenesRequest,
    cursor_of,
    keys_of,
)
from service.curation.scene_names import begins, parse_short_name
from service.store.record_digests import OnDamaged, problem_of
from service.store.selections import scene_ids_of
from service.store.tables import (
    LISTED_SCENES,
    LISTED_WORDS,
    LISTING_SOURCES,
    SCENES,
    VERDICTS,
)
from service.store.track_filters import contains, in_numbers, of_tracks
from service.store.verdict_rows import summaries

_C: Final = LISTED_SCENES.c
_IDS_AT_ONCE: Final = 5000


@dataclass(frozen=True, slots=True)
class _Order:
    """An order of the listing.

    Attributes:
        columns: Values that sort the rows and that a cursor contains; the last one is unique.
        descending: The greatest first.
    """

    columns: tuple[ColumnElement[Any], ...]
    descending: bool = False


_ORDERS: Final[dict[SceneOrder, _Order]] = {
    "score": _Order((_C.place, _C.start_ns, _C.seq)),
    "newest": _Order((_C.seq,), descending=True),
    "earliest": _Order((_C.start_ns, _C.seq)),
    "latest": _Order((_C.start_ns, _C.seq), descending=True),
    "judged": _Order((_C.judged,), descending=True),
}


def page(connection: Connection, request: ScenesRequest, *, on_damaged: OnDamaged) -> ScenesReply:
    """Read one page of the current scenes that pass the filters.

    Args:
        connection: To read from.
        request: Filters, order and cursor.
        on_damaged: Called for damaged scenes, which are left out.

    Raises:
        UsageError: If the cursor is of another order.
        NothingFoundError: If there is no such selection.
    """
    order = _ORDERS[request.sort]
    source, wanted = _searched(connection, request)
    columns = order.columns
    if source is not LISTED_SCENES:
        found = _found(connection, source, wanted)
        total, is_least = found.total, found.is_least
        source, wanted = found.source, found.wanted
        if is_least:  # the sum keeps SQLite from walking an index and finding each row's text
            columns = (columns[0] + 0, *columns[1:])
    else:
        counted = select(func.count()).select_from(LISTED_SCENES).where(wanted)
        total, is_least = connection.execute(counted).scalar_one(), False
    if request.after:
        keys = keys_of(request.sort, request.after, count=len(columns))
        wanted = and_(wanted, _beyond(order, keys))
    places = connection.execute(
        select(_C.seq, *(column.label(f"key_{n}") for n, column in enumerate(order.columns)))
        .select_from(source)
        .where(wanted)
        .order_by(*(column.desc() if order.descending else column for column in columns))
        .limit(request.most + 1)
    ).all()
    shown = places[: request.most]
    following = ""
    if len(places) > request.most:
        last = shown[-1]._mapping
        keys = tuple(last[f"key_{n}"] for n in range(len(order.columns)))
        following = cursor_of(request.sort, keys)
    rows = _rows(connection, [row.seq for row in shown], request.reviewer, on_damaged)
    return ScenesReply(rows=tuple(rows), next=following, total=total, is_least=is_least)


@dataclass(frozen=True, slots=True)
class _Found:
    """Result of a search.

    Attributes:
        source: Tables of the rows that are found.
        wanted: Condition on them.
        total: Number of matches, at most `MOST_COUNTED`.
        is_least: There are more.
    """

    source: FromClause
    wanted: ColumnElement[bool]
    total: int
    is_least: bool


def _found(connection: Connection, source: FromClause, wanted: ColumnElement[bool]) -> _Found:
    """Search every text in turn, and find the row of each match by its number.

    A few matches are then read by their numbers, so that the texts are read once.
    """
    matches = select(_C.seq).select_from(source).where(wanted).limit(MOST_COUNTED + 1)
    numbers = connection.execute(matches).scalars().all()
    if len(numbers) > MOST_COUNTED:
        return _Found(source, wanted, MOST_COUNTED, is_least=True)
    return _Found(LISTED_SCENES, in_numbers(_C.seq, numbers), len(numbers), is_least=False)


def numbers_that_pass(connection: Connection, request: ScenesRequest) -> set[int]:
    """Return the numbers of all current scenes that pass the filters; the order is not used."""
    source, wanted = _searched(connection, request)
    return set(connection.execute(select(_C.seq).select_from(source).where(wanted)).scalars())


def _searched(
    connection: Connection, request: ScenesRequest
) -> tuple[FromClause, ColumnElement[bool]]:
    """Return the tables that filters and search read, and their condition.

    A search reads the texts in their order. The sum keeps SQLite from walking the rows instead and
    finding the text of each.
    """
    wanted = and_(True, *_filters(connection, request))
    if not request.text or parse_short_name(request.text) is not None:
        return LISTED_SCENES, wanted
    source = LISTED_WORDS.join(LISTED_SCENES, _C.seq == LISTED_WORDS.c.seq + 0)
    words = contains(connection, LISTED_WORDS.c.words, request.text.casefold())
    return source, and_(wanted, words)


def _beyond(order: _Order, keys: Sequence[float | int]) -> ColumnElement[bool]:
    place = tuple_(
        *(
            bindparam(None, key, column.type)
            for key, column in zip(keys, order.columns, strict=True)
        )
    )
    return tuple_(*order.columns) < place if order.descending else tuple_(*order.columns) > place


def _filters(connection: Connection, request: ScenesRequest) -> list[ColumnElement[bool]]:
    """Return the conditions on the narrow rows."""
    found: list[ColumnElement[bool]] = []
    found += _of_sources(connection, request)
    found += of_tracks(connection, request)
    if request.since_ns is not None:
        found.append(_C.start_ns >= request.since_ns)
    if request.until_ns is not None:
        found.append(_C.start_ns < request.until_ns)
    if request.min_score:
        found.append(_C.place <= -request.min_score)
    if request.max_score is not None:
        found.append(_C.place >= -request.max_score)
    if request.selection is not None:
        ids = sorted(scene_ids_of(connection, request.selection))
        found.append(in_numbers(_C.seq, _numbers_of(connection, ids)))
    found += _of_verdicts(request)
    return found


def _of_verdicts(request: ScenesRequest) -> list[ColumnElement[bool]]:
    found: list[ColumnElement[bool]] = []
    if request.judged == "yes" or request.sort == "judged":
        found.append(_C.judged > 0)
    if request.judged == "no":
        found.append(_C.judged == 0)
    if request.judged in {"mine", "not_mine"}:
        mine = (
            select(SCENES.c.seq)
            .join(
                VERDICTS,
                and_(
                    VERDICTS.c.scene_id == SCENES.c.scene_id, VERDICTS.c.sha256 == SCENES.c.sha256
                ),
            )
            .where(
                SCENES.c.is_current,
                VERDICTS.c.is_current,
                VERDICTS.c.reviewer == (request.reviewer or ""),
            )
        )
        if request.judged == "mine":
            found += [_C.judged > 0, _C.seq.in_(mine)]
        else:
            found.append(or_(_C.judged == 0, _C.seq.not_in(mine)))
    return found


def _of_sources(connection: Connection, request: ScenesRequest) -> list[ColumnElement[bool]]:
    """Return the conditions on where a scene comes from: log, vehicle, version and stream."""
    c, wanted = LISTING_SOURCES.c, []
    if request.vehicle is not None:
        wanted.append(c.vehicle == request.vehicle)
    if request.software_version is not None:
        wanted.append(c.software_version == request.software_version)
    if request.mode is not None:
        named = func.substr(c.mode, 1, len(request.mode) + 1) == f"{request.mode}@"
        wanted.append(or_(c.mode == request.mode, named))
    found: list[ColumnElement[bool]] = []
    log, short = request.log, parse_short_name(request.text)
    if wanted or log is not None or short is not None:
        sources = connection.execute(select(c.source, c.log_id).where(and_(True, *wanted))).all()
        numbers = [
            row.source
            for row in sources
            if (log is None or fnmatchcase(row.log_id, log))
            and (short is None or f"/{row.log_id}".endswith(f"/{short[0]}"))
        ]
        found.append(in_numbers(_C.source, numbers))
    if short is not None:
        found += [_C.start_ns >= short[1], _C.start_ns < short[1] + NS_PER_S // 10]
    return found


def _numbers_of(connection: Connection, scene_ids: Sequence[str]) -> list[int]:
    numbers: list[int] = []
    for begin in range(0, len(scene_ids), _IDS_AT_ONCE):
        some = scene_ids[begin : begin + _IDS_AT_ONCE]
        query = select(SCENES.c.seq).where(SCENES.c.is_current, SCENES.c.scene_id.in_(some))
        numbers += connection.execute(query).scalars().all()
    return numbers


def _rows(
    connection: Connection, numbers: Sequence[int], reviewer: str | None, on_damaged: OnDamaged
) -> list[ListedScene]:
    """Read the scenes of a page from their records, in the order given."""
    stored = {
        row.seq: row
        for row in connection.execute(
            select(SCENES.c.seq, SCENES.c.scene_id, SCENES.c.sha256, SCENES.c.record).where(
                SCENES.c.seq.in_(numbers)
            )
        )
    }
    intact = []
    for seq in numbers:
        if problem := problem_of(stored[seq]):
            on_damaged(stored[seq].scene_id, problem)
        else:
            intact.append(stored[seq])
    judged = summaries(
        connection, [(row.scene_id, row.sha256) for row in intact], reviewer=reviewer
    )
    return [_listed(row, judged.get(row.scene_id, VerdictSummary())) for row in intact]


def _listed(row: Any, verdicts: VerdictSummary) -> ListedScene:
    score = decode(SceneScore, bytes(row.record))
    strong = [track for track in score.tracks if track.strength >= MIN_REPORTED_STRENGTH]
    first = strong[0] if strong else None
    return ListedScene(
        scene_id=score.scene_id,
        log_id=score.log_id,
        lidar_topic=score.lidar_topic,
        name=f"{score.log_id.rpartition('/')[2]}@{begins(score.start_ns)}",
        vehicle=score.vehicle,
        software_version=score.software_version,
        start_ns=score.start_ns,
        end_ns=score.end_ns,
        state=score.state.value,
        score=score.score,
        seq=row.seq,
        sha256=row.sha256,
        headline=score.reasons[0].headline if score.reasons else "",
        kind=first.kind if first else "",
        class_name=first.class_name if first else "",
        wrong=first.attribution.wrong if first and first.attribution else None,
        strength=first.strength if first else 0.0,
        tracks=tuple(TrackSummary.of(track) for track in strong[:MAX_LISTED_TRACKS]),
        verdicts=verdicts,
    )
