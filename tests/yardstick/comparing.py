"""What differs between two states of the project, first difference first."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from tests.yardstick.frozen import FrozenScene, Yardstick

ABSENT: Final = "(absent)"


def differences(before: Yardstick, after: Yardstick) -> Iterator[str]:
    """Yield a line for each scene whose values or overlay differ: the first field that does.

    Producers and texts do not count: see `other_texts`.
    """
    if before.simulated_log != after.simulated_log:
        yield "simulated log: the simulator writes other bytes"
    for name in dict.fromkeys((*before.runs, *after.runs)):
        ours, theirs = _by_id(before, name), _by_id(after, name)
        for scene_id in dict.fromkeys((*ours, *theirs)):
            one, other = ours.get(scene_id), theirs.get(scene_id)
            if one is None or other is None:
                yield f"{name} {scene_id}: mined only {'after' if one is None else 'before'}"
                continue
            changed = [
                *_changed(one.values, other.values),
                *(f"overlay.{each}" for each in _changed(one.overlay, other.overlay)),
            ]
            if changed:
                yield f"{name} {scene_id}: {len(changed)} fields differ, first {changed[0]}"


def other_texts(before: Yardstick, after: Yardstick) -> Iterator[str]:
    """Yield a line for each scene that is described in other words, with the first of them."""
    for name in before.runs:
        ours, theirs = _by_id(before, name), _by_id(after, name)
        for scene_id in ours.keys() & theirs.keys():
            changed = list(_changed(ours[scene_id].texts, theirs[scene_id].texts))
            if changed:
                yield f"{name} {scene_id}: {changed[0]}"


def _by_id(state: Yardstick, run: str) -> dict[str, FrozenScene]:
    return {scene.scene_id: scene for scene in state.runs.get(run, ())}


def _changed(one: Mapping[str, Any], other: Mapping[str, Any]) -> Iterator[str]:
    for field in dict.fromkeys((*one, *other)):
        was, became = one.get(field, ABSENT), other.get(field, ABSENT)
        if was != became:
            yield f"{field}: {was!r:.120} became {became!r:.120}"
