"""Choice of scenes by ranking, filters and earlier selections, and their failure modes."""

import json
from collections.abc import Sequence
from contextlib import closing

from sqlalchemy import Connection, func, select

from service.curation.candidates import Candidate, Proposal
from service.curation.mode_rows import DAY_NS, ModesReply, modes_reply
from service.curation.modes import modes_of, tracks_of
from service.curation.ranking import RankedScene
from service.curation.selection import USUAL_TERMS, SelectionTerms
from service.curation.strategies import catalogue
from service.curation.strategies.best_distinct import with_reason
from service.curation.strategies.catalogue import Wanted, strategy_named, strategy_of
from service.curation.strategies.covering import MOST_REMEMBERED
from service.errors import NothingFoundError
from service.store import listing, ranking
from service.store.engine import Store
from service.store.record_digests import OnDamaged, problem_of
from service.store.tables import SCENES, SELECTION_SCENES, SELECTIONS


class Proposals:
    """Chooses scenes for selections and groups tracks into modes; it stores nothing."""

    def __init__(self, store: Store) -> None:
        """Keep the store."""
        self._store = store

    def propose(
        self,
        *,
        budget: int,
        name: str | None = None,
        terms: SelectionTerms = USUAL_TERMS,
        wanted: Wanted = None,
    ) -> Proposal:
        """Choose scenes of the ranking by the terms.

        Args:
            budget: Number of scenes at most.
            name: Selection that is made. Where it is stored, the ones after it are not considered,
                so that the same request gives the same scenes again.
            terms: Strategy, filters and treatment of earlier selections.
            wanted: Scenes that a person chose; the terms are then not used.

        Raises:
            UsageError: If there is no such strategy.
            NothingFoundError: If a filter names a selection that does not exist, or a chosen scene
                is not current.
        """
        with self._store.reading() as connection:
            return _propose(
                connection,
                budget=budget,
                name=name,
                terms=terms,
                wanted=wanted,
                on_damaged=self._store.note_damaged,
            )

    def modes(self) -> ModesReply:
        """Group the strong tracks of the current scenes into failure modes."""
        with (
            self._store.reading() as connection,
            closing(ranking.candidates(connection, on_damaged=self._store.note_damaged)) as ranked,
        ):
            tracks = tracks_of(with_reason(ranked))
            driven_ns = _driven_ns(connection)
        return modes_reply(modes_of(tracks), tracks=len(tracks), driven_ns=driven_ns)

    def select(
        self,
        *,
        budget: int,
        name: str | None = None,
        terms: SelectionTerms = USUAL_TERMS,
        wanted: Wanted = None,
    ) -> list[RankedScene]:
        """Choose scenes as `propose` does, and return them best first."""
        proposal = self.propose(budget=budget, name=name, terms=terms, wanted=wanted)
        return sorted((each.scene for each in proposal.choices), key=lambda scene: scene.rank)


def _propose(
    connection: Connection,
    *,
    budget: int,
    name: str | None,
    terms: SelectionTerms,
    wanted: Wanted,
    on_damaged: OnDamaged,
) -> Proposal:
    """Choose scenes as `Proposals.propose` says, in the transaction to read from."""
    strategy_named(terms.strategy)
    earlier = [] if terms.again or wanted is not None else _earlier(connection, name)
    taken = {json.loads(scene)["scene_id"] for scene in earlier}
    only = None
    if terms.filters is not None and wanted is None:
        only = listing.numbers_that_pass(connection, terms.filters)
    with closing(ranking.candidates(connection, only=only, on_damaged=on_damaged)) as ranked:
        choices = catalogue.select(
            (each for each in ranked if each.scene.scene_id not in taken),
            budget=budget,
            strategy=terms.strategy,
            wanted=wanted,
            taken=_candidates(connection, earlier[-MOST_REMEMBERED:]),
        )
    if wanted is not None and len(choices) < min(budget, len(set(wanted))):
        missing = set(wanted) - {each.scene.scene_id for each in choices}
        raise NothingFoundError(
            f"no current scene {min(missing)!r}, which was chosen; `counterpoint top` lists them"
        )
    return Proposal(
        strategy=strategy_of(wanted, terms.strategy),
        budget=budget,
        taken=len(taken),
        choices=tuple(choices),
    )


def _driven_ns(connection: Connection) -> dict[int, int]:
    """Sum the duration of the current scenes by day since the Unix epoch, nanoseconds."""
    day = (SCENES.c.start_ns // DAY_NS).label("day")
    driven = func.sum(SCENES.c.end_ns - SCENES.c.start_ns).label("driven_ns")
    query = select(day, driven).where(SCENES.c.is_current).group_by(day)
    return {int(row.day): int(row.driven_ns) for row in connection.execute(query)}


def _earlier(connection: Connection, name: str | None) -> list[str]:
    """Return the scenes of earlier selections as stored, oldest first."""
    query = (
        select(SELECTION_SCENES.c.scene)
        .join(SELECTIONS, SELECTIONS.c.name == SELECTION_SCENES.c.name)
        .order_by(SELECTIONS.c.ordinal, SELECTION_SCENES.c.position)
    )
    if name is not None:
        own = connection.execute(select(SELECTIONS.c.ordinal).where(SELECTIONS.c.name == name))
        ordinal = own.scalar_one_or_none()
        if ordinal is not None:
            query = query.where(SELECTIONS.c.ordinal < ordinal)
    return list(connection.execute(query).scalars())


def _candidates(connection: Connection, stored: Sequence[str]) -> list[Candidate]:
    """Read stored scenes; of one that is no longer current, nothing else is known."""
    scenes = [RankedScene.model_validate_json(scene) for scene in stored]
    c = SCENES.c
    query = select(c.scene_id, c.vehicle, c.software_version, c.record, c.sha256).where(
        c.is_current, c.scene_id.in_([scene.scene_id for scene in scenes])
    )
    sources = {row.scene_id: row for row in connection.execute(query) if not problem_of(row)}
    return [
        Candidate(
            *(scene, found.vehicle, found.software_version),
            cloud=ranking.cloud_in(record := json.loads(found.record)),
            place=ranking.place_in(record),
        )
        if (found := sources.get(scene.scene_id))
        else Candidate(scene)
        for scene in scenes
    ]
