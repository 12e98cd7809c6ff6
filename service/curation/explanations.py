"""Sentences that explain each choice of a selection in a line. Pure."""

from collections.abc import Sequence
from typing import Final

from service.curation.candidates import BALANCED, Candidate, rows_of
from service.curation.descriptors import describing
from service.curation.places import CELL_M, apart_m, spot_of
from service.curation.twins import is_in_place

LIKE: Final = 0.8
"""Likeness from which a choice is named as like an earlier one."""


def why_best(candidate: Candidate) -> str:
    """Explain a choice by score alone."""
    if candidate.scene.twin_of is not None:
        return why_twin(candidate)
    return f"score {candidate.scene.score:.3f}: {shown(candidate)}"


def why_twin(candidate: Candidate) -> str:
    """Explain a twin that fills the budget."""
    scene = candidate.scene
    what = "a twin"
    if scene.twin_of is not None and is_in_place(scene.scene_id, scene.twin_of):
        what = f"same place as {scene.twin_of}"
    return f"score {scene.score:.3f}: {what}, which fills the budget"


def whys(chosen: Sequence[Candidate], *, before: Sequence[Candidate]) -> list[str]:
    """Explain choices in their order: score, what the scene shows, and what is new in it.

    Args:
        chosen: In the order of choice.
        before: Scenes of earlier selections that were compared.
    """
    everything = [*before, *chosen]
    descriptors = rows_of(everything).descriptors
    seen = [{each.groups[group] for each in before} for group in range(len(BALANCED))]
    found = []
    for number, candidate in enumerate(chosen, start=len(before)):
        parts = [f"score {candidate.scene.score:.3f}: {shown(candidate)}"]
        if number == 0:
            parts.append("the first choice")
        else:
            likeness = descriptors[:number] @ descriptors[number]
            nearest = int(likeness.argmax())
            degree = float(likeness[nearest])
            other = everything[nearest].scene
            where = "selected earlier" if nearest < len(before) else f"rank {other.rank}"
            parts.append(
                f"{'like' if degree >= LIKE else 'unlike all; nearest is'} "
                f"{where} (likeness {degree:.2f})"
            )
        if (again := _same_place(candidate, everything[:number])) is not None:
            known = (
                "selected earlier"
                if again < len(before)
                else f"rank {everything[again].scene.rank}"
            )
            parts.append(f"within {CELL_M:.0f} m of {known}")
        new = []
        for group, (name, value) in enumerate(zip(BALANCED, candidate.groups, strict=True)):
            if value and value not in seen[group]:
                new.append(f"first of {name} {value}")
            seen[group].add(value)
        found.append("; ".join(parts + new))
    return found


def _same_place(candidate: Candidate, earlier: Sequence[Candidate]) -> int | None:
    """Return the number of the first scene within `CELL_M` of a candidate."""
    if candidate.place is None:
        return None
    here = spot_of(candidate.place)
    for number, each in enumerate(earlier):
        if each.place is not None and apart_m(here, spot_of(each.place)) <= CELL_M:
            return number
    return None


def shown(candidate: Candidate) -> str:
    """Describe the strongest listed track of a scene in a few words."""
    tracks = describing(candidate.scene)
    if not tracks:
        return "no strong track"
    track = tracks[0]
    what = f"{track.kind} {track.class_name}".strip()
    others = f" and {len(tracks) - 1} more" if len(tracks) > 1 else ""
    return f"{what}, {track.size_m[0]:.1f} m long, {track.range_m:.0f} m away{others}"
