"""Rows of the listing: one for each current scene, written and deleted with it."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import structlog
from sqlalchemy import Connection, Table, bindparam, delete, func, insert, select, update

from schemas.canonical import canonical_json, sha256
from schemas.contradiction import SceneState, TrackRecord
from schemas.score import MIN_REPORTED_STRENGTH, SceneScore
from service.curation.ranges import bits_of
from service.store.record_digests import problem_of
from service.store.statements import Statement
from service.store.tables import (
    LISTED_SCENES,
    LISTED_TRACKS,
    LISTED_WORDS,
    LISTING_FINDINGS,
    LISTING_SOURCES,
    LISTING_THINGS,
    SCENES,
    VERDICTS,
)

log = structlog.get_logger(__name__)

MOST_WORDS: Final = 400
"""Characters of the headlines of a scene that a search looks in."""

NOT_SCORED: Final = 1.0
"""`place` of a scene without a valid score: after that of every score, which is 0 or less."""

_AT_ONCE: Final = 500
"""Scenes in memory at a time while old ones are listed."""

_REPORTED: Final = 100_000
"""Interval of reports while old scenes are listed, scenes."""

_COMPARED: Final = (
    "both_static",
    "both_dynamic",
    "only_semantic_dynamic",
    "only_predictive_dynamic",
)
_CONTRADICTING: Final = _COMPARED[2:]


ListedNow = tuple[int, SceneScore, str, Mapping[str, int]]
"""Number of a scene, its score, the digest of its record, and its points by outcome."""


def list_scenes(connection: Connection, scenes: Sequence[ListedNow]) -> None:
    """List scenes that become current, in the transaction that stores them."""
    if scenes:
        _list(connection, scenes)


def unlist(connection: Connection, numbers: Collection[int]) -> None:
    """Delete scenes that are no longer current, by their numbers."""
    going = [{"at_seq": seq} for seq in numbers]
    if going:
        _UNLIST.run_each(connection, going)
        _UNLIST_TRACKS.run_each(connection, going)
        _UNLIST_WORDS.run_each(connection, going)


def list_stored(connection: Connection, numbers: Sequence[int]) -> None:
    """List scenes that are current again, from their stored records.

    A damaged record is left out, since it is not shown either.
    """
    for begin in range(0, len(numbers), _AT_ONCE):
        some = numbers[begin : begin + _AT_ONCE]
        rows = connection.execute(_STORED.where(SCENES.c.seq.in_(some)))
        _list(connection, [_read(row) for row in rows if not problem_of(row)])


def list_stored_scenes(connection: Connection) -> None:
    """List every current scene of a database that had no listing; the migration calls it."""
    last, listed = 0, 0
    while True:
        rows = connection.execute(
            _STORED.where(SCENES.c.is_current, SCENES.c.seq > last)
            .order_by(SCENES.c.seq)
            .limit(_AT_ONCE)
        ).all()
        if not rows:
            return
        _list(connection, [_read(row) for row in rows if not problem_of(row)])
        last, before = rows[-1].seq, listed
        listed += len(rows)
        if listed // _REPORTED > before // _REPORTED:
            log.info("the listing is filled from stored scenes", scenes=listed)


def judge_again(connection: Connection, scene_id: str, digest: str) -> None:
    """Note the last verdict that counts on a record, if it is the current one of its scene."""
    seq = connection.execute(
        select(SCENES.c.seq).where(
            SCENES.c.is_current, SCENES.c.scene_id == scene_id, SCENES.c.sha256 == digest
        )
    ).scalar_one_or_none()
    if seq is not None:
        last = _last_verdict(connection, scene_id, digest)
        connection.execute(
            update(LISTED_SCENES).where(LISTED_SCENES.c.seq == seq).values(judged=last)
        )


def set_of(values: Iterable[str]) -> str:
    """Write a set of names as one text, `|a|b|`; empty for none."""
    names = sorted({_without_bars(value) for value in values if value})
    return f"|{'|'.join(names)}|" if names else ""


def _without_bars(name: str) -> str:
    return name.replace("|", "/")


def _read(row: Any) -> ListedNow:
    """Return what is listed of a stored scene."""
    score = SceneScore.model_validate_json(bytes(row.record))
    counts = {name: int(row._mapping[name]) for name in _COMPARED}
    return row.seq, score, row.sha256, counts


def _list(connection: Connection, rows: Sequence[ListedNow]) -> None:
    known: dict[tuple[str, ...], int] = {}
    any_verdict = bool(_ANY_VERDICT.rows(connection, {}))
    listed, tracks, words = [], [], []
    for seq, score, digest, counts in rows:
        judged = _last_verdict(connection, score.scene_id, digest) if any_verdict else 0
        near, far = bits_of(track.strongest.range_m for track in _strong(score))
        for thing, of_thing in _things_of(score).items():
            values = dict(zip(("kind", "class_name", "wrong"), thing, strict=True))
            number = _number_of(connection, _THINGS, values, known)
            near_ones, far_ones = bits_of(track.strongest.range_m for track in of_thing)
            tracks.append(
                {"thing": number, "seq": seq, "near_ranges": near_ones, "far_ranges": far_ones}
            )
        listed.append(
            {
                "seq": seq,
                "place": place_of(score),
                "start_ns": score.start_ns,
                "source": _number_of(connection, _SOURCES, _source_of(score), known),
                "finding": _number_of(connection, _FINDINGS, _finding_of(score), known),
                "judged": judged,
                "compared": sum(counts[name] for name in _COMPARED),
                "contradicting": sum(counts[name] for name in _CONTRADICTING),
                "near_ranges": near,
                "far_ranges": far,
            }
        )
        words.append({"seq": seq, "words": words_of(score)})
    if listed:
        _INSERT.run_each(connection, listed)
        _INSERT_TRACKS.run_each(connection, tracks)
        _INSERT_WORDS.run_each(connection, words)


def place_of(score: SceneScore) -> float:
    """Return the place of a scene in the order of scores: lower is earlier."""
    return 0.0 - score.score if score.state is SceneState.SCORED else NOT_SCORED


def words_of(score: SceneScore) -> str:
    """Return the text that a search looks in, in lower case."""
    headlines = " ".join(reason.headline for reason in score.reasons)[:MOST_WORDS]
    return f"{score.scene_id} {headlines}".casefold()


def names_in(names: str) -> tuple[str, ...]:
    """Read a set that `set_of` wrote."""
    return tuple(names.strip("|").split("|")) if names else ()


def kinds_of(score: SceneScore) -> str:
    """Return the kinds of the strong tracks of a scene, as a set in one text."""
    return set_of(track.kind for track in _strong(score))


def _strong(score: SceneScore) -> Iterable[TrackRecord]:
    return (track for track in score.tracks if track.strength >= MIN_REPORTED_STRENGTH)


def _source_of(score: SceneScore) -> dict[str, str]:
    return {
        "log_id": score.log_id,
        "lidar_topic": score.lidar_topic,
        "vehicle": score.vehicle,
        "software_version": score.software_version,
        "mode": score.producers.supervised,
    }


def _finding_of(score: SceneScore) -> dict[str, str]:
    strong = list(_strong(score))
    return {
        "kinds": set_of(track.kind for track in strong),
        "class_names": set_of(track.class_name for track in strong),
        "wrongs": set_of(track.attribution.wrong for track in strong if track.attribution),
    }


def _things_of(score: SceneScore) -> dict[tuple[str, str, str], list[TrackRecord]]:
    """Return the strong tracks of a scene by kind, class and attribution."""
    found: dict[tuple[str, str, str], list[TrackRecord]] = {}
    for track in _strong(score):
        wrong = track.attribution.wrong.value if track.attribution else ""
        thing = (track.kind, _without_bars(track.class_name), wrong)
        found.setdefault(thing, []).append(track)
    return found


@dataclass(frozen=True, slots=True)
class _Named:
    """A table of repeating values, which are named by a number."""

    name: str
    find: Statement
    add: Statement


def _named(table: Table) -> _Named:
    number = table.primary_key.columns.values()[0]
    return _Named(
        name=table.name,
        find=Statement(
            select(number.label("number")).where(table.c.digest == bindparam("at_digest"))
        ),
        add=Statement(
            insert(table)
            .values(
                {number.name: select(func.coalesce(func.max(number), 0) + 1).scalar_subquery()}
                | {
                    column.name: bindparam(column.name)
                    for column in table.columns
                    if column is not number
                }
            )
            .returning(number.label("number"))
        ),
    )


def _number_of(
    connection: Connection,
    named: _Named,
    values: dict[str, str],
    known: dict[tuple[str, ...], int],
) -> int:
    """Return the number of these values; they get the next one when they are new."""
    found = (named.name, *values.values())
    number = known.get(found)
    if number is None:
        digest = sha256(canonical_json(values))
        row = named.find.first(connection, {"at_digest": digest})
        row = row or named.add.one(connection, {"digest": digest, **values})
        number = known[found] = row.number
    return number


def _last_verdict(connection: Connection, scene_id: str, digest: str) -> int:
    return int(_LAST_VERDICT.one(connection, {"scene": scene_id, "at_digest": digest}).last)


_SOURCES: Final = _named(LISTING_SOURCES)
_FINDINGS: Final = _named(LISTING_FINDINGS)
_THINGS: Final = _named(LISTING_THINGS)
_INSERT: Final = Statement(insert(LISTED_SCENES))
_INSERT_TRACKS: Final = Statement(insert(LISTED_TRACKS))
_INSERT_WORDS: Final = Statement(insert(LISTED_WORDS))
_UNLIST: Final = Statement(delete(LISTED_SCENES).where(LISTED_SCENES.c.seq == bindparam("at_seq")))
_UNLIST_TRACKS: Final = Statement(
    delete(LISTED_TRACKS).where(LISTED_TRACKS.c.seq == bindparam("at_seq"))
)
_UNLIST_WORDS: Final = Statement(
    delete(LISTED_WORDS).where(LISTED_WORDS.c.seq == bindparam("at_seq"))
)
_ANY_VERDICT: Final = Statement(select(VERDICTS.c.ordinal).limit(1))
_LAST_VERDICT: Final = Statement(
    select(func.coalesce(func.max(VERDICTS.c.ordinal), 0).label("last")).where(
        VERDICTS.c.scene_id == bindparam("scene"),
        VERDICTS.c.sha256 == bindparam("at_digest"),
        VERDICTS.c.is_current,
    )
)
_STORED: Final = select(
    SCENES.c.seq, SCENES.c.record, SCENES.c.sha256, *(SCENES.c[name] for name in _COMPARED)
)
