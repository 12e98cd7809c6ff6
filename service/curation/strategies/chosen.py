"""The scenes that a person chose, such as those that pass the filters of a page."""

from collections.abc import Collection, Iterable

from service.curation.candidates import Candidate, Choice


def chosen(
    candidates: Iterable[Candidate], *, budget: int, wanted: Collection[str]
) -> list[Choice]:
    """Choose the wanted scenes; the best of them if they exceed the budget.

    Args:
        candidates: Best first; read only as far as needed.
        budget: Scenes the labellers can take, at least 1.
        wanted: Ids of scenes; one that is no longer current is left out.

    Returns:
        At most `budget` choices, best first.
    """
    missing = set(wanted)
    found: list[Choice] = []
    for each in candidates:
        if each.scene.scene_id in missing:
            missing.discard(each.scene.scene_id)
            found.append(Choice(scene=each.scene, gain=each.scene.score, why="chosen by hand"))
        if not missing or len(found) == budget:
            break
    return found
