"""Comparison of two versions: rates by group, intervals, outcomes, and the scenes that show them.

Pure. A group regressed if its rate is higher on side B, beyond the tolerance, and significantly so
after the correction for the number of groups.
"""

from collections import defaultdict
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from service.curation.compared_scenes import (
    ComparedScene,
    Matched,
    NamedSide,
    match_scenes,
)
from service.curation.compared_tracks import ComparedTrack, Group, grouped_tracks, unmatched
from service.curation.comparison import (
    EXAMPLES,
    MOST_PLACES,
    ComparedExample,
    ComparedGroup,
    ComparedPlace,
    Comparison,
    ComparisonTerms,
    Match,
    Outcome,
    PlaceExtent,
    Rate,
    SideSummary,
)
from service.curation.comparison_answers import answers_less, labelled_share
from service.curation.comparison_rates import Amount, per_hour
from service.curation.comparison_statistics import (
    LEVEL,
    Numbers,
    Tested,
    holm,
    quantile,
)
from service.errors import NothingFoundError, UsageError

FEWEST_LOGS: Final = 4
"""Logs of each side at least, and logs in which a group occurs that is tested."""

FEWEST_TRACKS: Final = 6
"""Tracks of a group on both sides together, from which on it is tested."""

_FAR: Final = 1e9
"""Bound of an interval that is not known, tracks per hour."""


def compare(a: NamedSide, b: NamedSide, terms: ComparisonTerms) -> Comparison:
    """Compare two versions; groups are listed with the most significant regression first.

    Raises:
        NothingFoundError: If a side has no scored scene, or both have no log or road in common.
        UsageError: If a side has too few logs to compare.
    """
    for side in (a, b):
        if not side.scenes:
            raise NothingFoundError(f"no scored scene of {side.name}: there is nothing to compare")
    matched = match_scenes(a, b, terms.match)
    _need_logs(a.name, matched.a, terms.match, matched)
    _need_logs(b.name, matched.b, terms.match, matched)
    tracks, has_modes = grouped_tracks(matched.a, matched.b)
    known = sorted({group for each in tracks for group in each.groups})
    kept = [group for group in known if _is_enough(group, tracks)]
    column = {group: at for at, group in enumerate(kept)}
    amounts = [
        Amount(each.side, each.scene, column[group], 1.0)
        for each in tracks
        for group in each.groups
        if group in column
    ]
    tested = per_hour(matched, amounts, groups=len(kept), tolerance=terms.tolerance)
    rows = _rows(matched, tracks, kept, tested, terms.tolerance) if kept else []
    return Comparison(
        a=_summary(a, matched.a),
        b=_summary(b, matched.b),
        matched="roads" if matched.roads else "logs",
        roads=matched.roads,
        places=len(matched.places),
        places_too_few=matched.places_too_few,
        at_places=_places(matched),
        tolerance=terms.tolerance,
        comparisons=len(rows),
        too_few=len(known) - len(rows),
        modes=has_modes,
        regressed=sum(row.outcome == "regressed" for row in rows),
        improved=sum(row.outcome == "improved" for row in rows),
        groups=tuple(sorted(rows, key=_worst_first)),
        answers_less=answers_less(matched),
    )


def _need_logs(name: str, scenes: Sequence[ComparedScene], match: Match, matched: Matched) -> None:
    logs = len({scene.log_id for scene in scenes})
    if logs == 0 and match == "logs":
        raise NothingFoundError(
            "the sides have no log in common: compare the same kinds of road with --match roads"
        )
    if logs == 0:
        raise NothingFoundError("the sides have no log and no kind of road in common")
    if logs < FEWEST_LOGS:
        what = "on kinds of road that both sides drove" if matched.roads else "that both sides have"
        few = f"{logs} log{'s' * (logs != 1)}"
        raise UsageError(
            f"too few logs for an interval: {name} has {few} {what}, and a comparison needs "
            f"{FEWEST_LOGS} of each side"
        )


def _places(matched: Matched) -> tuple[ComparedPlace, ...]:
    """Return the places that are compared by themselves, the greatest rise of tracks first."""
    sides = ((matched.a, matched.at_a), (matched.b, matched.at_b))
    found = [
        ComparedPlace(place=place, a=_at(place, *sides[0]), b=_at(place, *sides[1]))
        for place in matched.places
    ]
    found.sort(key=lambda row: (row.a.tracks - row.b.tracks, row.place))
    return tuple(found[:MOST_PLACES])


def _at(place: str, scenes: Sequence[ComparedScene], at: Sequence[str]) -> PlaceExtent:
    here = [scene for scene, name in zip(scenes, at, strict=True) if name == place]
    return PlaceExtent(
        logs=len({scene.log_id for scene in here}),
        scenes=len(here),
        tracks=sum(len(scene.tracks) for scene in here),
    )


def _summary(side: NamedSide, kept: Sequence[ComparedScene]) -> SideSummary:
    return SideSummary(
        name=side.name,
        logs=len({scene.log_id for scene in kept}),
        scenes=len(kept),
        hours=round(sum(scene.hours for scene in kept), 4),
        left_out=len(side.scenes) - len(kept),
        labelled_share=round(labelled_share(kept), 4),
    )


def _is_enough(group: Group, tracks: Sequence[ComparedTrack]) -> bool:
    """Return true if a group can be tested; that does not depend on which side has its tracks."""
    members = [each for each in tracks if group in each.groups]
    logs = {each.scene.log_id for each in members}
    return len(members) >= FEWEST_TRACKS and len(logs) >= FEWEST_LOGS


def _rows(
    matched: Matched,
    tracks: Sequence[ComparedTrack],
    groups: Sequence[Group],
    tested: Tested,
    tolerance: float,
) -> list[ComparedGroup]:
    members: defaultdict[Group, list[int]] = defaultdict(list)
    for number, each in enumerate(tracks):
        for group in each.groups:
            members[group].append(number)
    alone = None if matched.roads else unmatched(tracks)
    corrected, levels = holm(tested.p)
    outcomes = _outcomes(tested, corrected, tolerance)
    rows = []
    for at, group in enumerate(groups):
        mine = [tracks[number] for number in members[group]]
        single = None if alone is None else [alone[number] for number in members[group]]
        difference = float(tested.rate_b[at] - tested.rate_a[at])
        usual, wide = (quantile(each) * tested.error[at] for each in (LEVEL, levels[at]))
        rows.append(
            ComparedGroup(
                by=group.by,
                group=group.group,
                name=group.name,
                a=_rate(mine, "a", tested.rate_a[at], tested.error_a[at], len(matched.a)),
                b=_rate(mine, "b", tested.rate_b[at], tested.error_b[at], len(matched.b)),
                difference=round(difference, 4),
                low=_bounded(difference - usual),
                high=_bounded(difference + usual),
                corrected_low=_bounded(difference - wide),
                corrected_high=_bounded(difference + wide),
                p=round(float(tested.p[at]), 6),
                corrected_p=round(float(corrected[at]), 6),
                outcome=outcomes[at],
                gone=None if single is None else _count(mine, single, "a"),
                new=None if single is None else _count(mine, single, "b"),
                examples=_examples(mine, single, outcomes[at]),
            )
        )
    return rows


def _outcomes(tested: Tested, corrected: Numbers, tolerance: float) -> list[Outcome]:
    allowed = (1.0 + tolerance) * tested.rate_a
    found: list[Outcome] = []
    for at, p in enumerate(corrected.tolist()):
        if p >= LEVEL:
            found.append("same")
        else:
            found.append("regressed" if tested.rate_b[at] > allowed[at] else "improved")
    return found


def _rate(
    mine: Sequence[ComparedTrack], side: str, per_hour: float, error: float, scenes: int
) -> Rate:
    on_side = [each for each in mine if each.side == side]
    half = quantile(LEVEL) * error
    return Rate(
        tracks=len(on_side),
        scenes=len({each.scene.scene_id for each in on_side}),
        per_hour=round(float(per_hour), 4),
        low=_bounded(max(0.0, per_hour - half)),
        high=_bounded(per_hour + half),
        per_scene=round(len(on_side) / scenes, 4),
    )


def _bounded(value: float | NDArray[np.float64]) -> float:
    return round(float(np.clip(value, -_FAR, _FAR)), 4)


def _count(mine: Sequence[ComparedTrack], single: Sequence[bool], side: str) -> int:
    return sum(each.side == side and one for each, one in zip(mine, single, strict=True))


def _examples(
    mine: Sequence[ComparedTrack], single: Sequence[bool] | None, outcome: Outcome
) -> tuple[ComparedExample, ...]:
    """Return the strongest tracks of the worse side; of the same logs, those it alone shows."""
    if outcome == "same":
        return ()
    side = "b" if outcome == "regressed" else "a"
    shown = single or [True] * len(mine)
    wanted = [each for each, one in zip(mine, shown, strict=True) if each.side == side and one]
    found: dict[str, ComparedExample] = {}
    for each in sorted(wanted, key=lambda each: (-each.track.strength, each.scene.scene_id)):
        if len(found) < EXAMPLES and each.scene.scene_id not in found:
            found[each.scene.scene_id] = ComparedExample(
                side=each.side,
                scene_id=each.scene.scene_id,
                track_id=each.track.track_id,
                strength=each.track.strength,
                headline=_headline(each),
            )
    return tuple(found.values())


def _headline(each: ComparedTrack) -> str:
    track = each.track
    speed = f"{track.speed_m_per_s:.0f} m/s" if track.speed_m_per_s > 0 else "speed unmeasured"
    return (
        f"{track.class_name or 'no class'}, {track.kind.replace('_', ' ')}, "
        f"{track.strongest.size_m[0]:.1f} m long, {track.strongest.range_m:.0f} m away, {speed}"
    )


def _worst_first(row: ComparedGroup) -> tuple[int, float, str, str]:
    order = {"regressed": 0, "improved": 1, "same": 2}
    return order[row.outcome], row.corrected_p, row.by, row.group
