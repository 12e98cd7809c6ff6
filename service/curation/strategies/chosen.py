"""The scenes that a person chose, such as those that pass the filters of a page."""

from collections.abc import Collection, Iterable

from service.curation.ranking import RankedScene


def chosen(
    ranking: Iterable[RankedScene], *, budget: int, wanted: Collection[str]
) -> list[RankedScene]:
    """Choose the wanted scenes; the best of them if they exceed the budget.

    Args:
        ranking: Best first; read only as far as needed.
        budget: Scenes the labellers can take, at least 1.
        wanted: Ids of scenes; one that is no longer current is left out.

    Returns:
        At most `budget` scenes, best first.
    """
    missing = set(wanted)
    found: list[RankedScene] = []
    for scene in ranking:
        if scene.scene_id in missing:
            missing.discard(scene.scene_id)
            found.append(scene)
        if not missing or len(found) == budget:
            break
    return found
