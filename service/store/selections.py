"""Named selections in the store: written once, never changed."""

import json
from collections.abc import Callable, Sequence

from sqlalchemy import Connection, func, insert, select, update

from service.curation.ranking import RankedScene
from service.curation.selection import Selection, SelectionSummary
from service.curation.strategies.catalogue import DEFAULT
from service.errors import NothingFoundError, UsageError
from service.store import audit
from service.store.engine import Store
from service.store.tables import COUNTERS, SELECTION_SCENES, SELECTIONS


class SelectionExistsError(UsageError):
    """Another selection has this name, and labellers may be working on it."""


class Selections:
    """Stored selections; a selection never changes, because labellers work from it."""

    def __init__(self, store: Store, *, now_s: Callable[[], float]) -> None:
        """Keep the store and the clock for what is durable, seconds."""
        self._store, self._now_s = store, now_s

    def save(
        self,
        name: str | None,
        *,
        budget: int,
        scenes: Sequence[RankedScene],
        strategy: str = DEFAULT,
    ) -> Selection:
        """Store a named selection; without a name it becomes `selection-<n>`.

        The same one again is no error.

        Raises:
            SelectionExistsError: If a different selection has this name.
        """
        now_s, who = self._now_s(), audit.actor()
        with self._store.writing() as connection:
            stored = _save(
                connection, name, strategy=strategy, budget=budget, scenes=scenes, now_s=now_s
            )
            chosen = audit.few([scene.scene_id for scene in stored.scenes])
            detail = {"selection": stored.name, "strategy": stored.strategy, "scenes": chosen}
            audit.record(connection, who, "select", detail, now_s=now_s)
            return stored

    def one(self, name: str) -> Selection | None:
        """Return the selection of this name."""
        with self._store.reading() as connection:
            return _read(connection, name)

    def all(self) -> list[Selection]:
        """Return every selection, oldest first."""
        with self._store.reading() as connection:
            names = connection.execute(
                select(SELECTIONS.c.name).order_by(SELECTIONS.c.ordinal)
            ).scalars()
            found = (_read(connection, name) for name in names.all())
            return [each for each in found if each is not None]

    def listed(self) -> list[SelectionSummary]:
        """Return every selection without its scenes, oldest first."""
        with self._store.reading() as connection:
            return _listed(connection)


def scene_ids_of(connection: Connection, name: str) -> set[str]:
    """Return the ids of the scenes of a selection.

    Raises:
        NothingFoundError: If there is none of this name.
    """
    stored = select(SELECTIONS.c.name).where(SELECTIONS.c.name == name)
    if connection.execute(stored).one_or_none() is None:
        raise NothingFoundError(f"no selection {name!r}; `counterpoint selection list` lists them")
    scenes = select(SELECTION_SCENES.c.scene).where(SELECTION_SCENES.c.name == name)
    return {json.loads(scene)["scene_id"] for scene in connection.execute(scenes).scalars()}


def _save(
    connection: Connection,
    name: str | None,
    *,
    strategy: str,
    budget: int,
    scenes: Sequence[RankedScene],
    now_s: float,
) -> Selection:
    """Store a selection under an unused name.

    Storing the same selection again is no error, since the answer to the first request may be lost.

    Raises:
        SelectionExistsError: If a different selection has this name.
    """
    ordinal = connection.execute(
        update(COUNTERS)
        .where(COUNTERS.c.name == "selection")
        .values(value=COUNTERS.c.value + 1)
        .returning(COUNTERS.c.value)
    ).scalar_one()
    if name is None:
        name = _free_name(connection, ordinal)
    wanted = Selection(name=name, strategy=strategy, budget=budget, scenes=tuple(scenes))
    stored = _read(connection, name)
    if stored == wanted:
        return stored
    if stored is not None:
        raise SelectionExistsError(
            f"selection {name!r} exists: {len(stored.scenes)} scenes under a budget of "
            f"{stored.budget}, not this choice; "
            "selections never change, choose another name"
        )
    connection.execute(
        insert(SELECTIONS).values(
            name=name, ordinal=ordinal, budget=budget, created_s=now_s, strategy=strategy
        )
    )
    rows = [
        {"name": name, "position": position, "scene": scene.model_dump_json()}
        for position, scene in enumerate(scenes)
    ]
    if rows:
        connection.execute(insert(SELECTION_SCENES), rows)
    return wanted


def _read(connection: Connection, name: str) -> Selection | None:
    """Read one selection."""
    row = connection.execute(select(SELECTIONS).where(SELECTIONS.c.name == name)).one_or_none()
    if row is None:
        return None
    scenes = connection.execute(
        select(SELECTION_SCENES.c.scene)
        .where(SELECTION_SCENES.c.name == name)
        .order_by(SELECTION_SCENES.c.position)
    ).scalars()
    return Selection(
        name=name,
        strategy=row.strategy,
        budget=row.budget,
        scenes=tuple(RankedScene.model_validate_json(scene) for scene in scenes),
    )


def _listed(connection: Connection) -> list[SelectionSummary]:
    """Read every selection without its scenes, oldest first."""
    counts = (
        select(SELECTION_SCENES.c.name, func.count().label("scenes"))
        .group_by(SELECTION_SCENES.c.name)
        .subquery()
    )
    rows = connection.execute(
        select(SELECTIONS, func.coalesce(counts.c.scenes, 0).label("scenes"))
        .outerjoin(counts, counts.c.name == SELECTIONS.c.name)
        .order_by(SELECTIONS.c.ordinal)
    )
    return [
        SelectionSummary(
            name=row.name,
            strategy=row.strategy,
            budget=row.budget,
            scenes=row.scenes,
            created_s=row.created_s,
        )
        for row in rows
    ]


def _free_name(connection: Connection, ordinal: int) -> str:
    number = ordinal
    while _read(connection, f"selection-{number}") is not None:
        number += 1  # somebody gave this name by hand
    return f"selection-{number}"
