"""Amounts of both sides of a comparison per hour driven, by log: tracks, or time. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.curation.compared_scenes import ComparedScene, Matched
from service.curation.comparison import SideOf
from service.curation.comparison_statistics import Road, Tested, over_logs, over_roads


@dataclass(frozen=True, slots=True)
class Amount:
    """Contribution of a scene to one group.

    Attributes:
        side: Side of the scene.
        scene: The scene.
        group: Number of the group.
        amount: Number of tracks, or hours.
    """

    side: SideOf
    scene: ComparedScene
    group: int
    amount: float


def per_hour(
    matched: Matched, amounts: Sequence[Amount], *, groups: int, tolerance: float
) -> Tested:
    """Compare what both sides have of each group, per hour driven.

    Args:
        matched: Scenes of both sides.
        amounts: What they add.
        groups: Number of groups.
        tolerance: Share by which B may exceed A.
    """
    if matched.roads:
        return _on_roads(matched, amounts, groups=groups, tolerance=tolerance)
    logs = {log: at for at, log in enumerate(sorted({scene.log_id for scene in matched.a}))}
    hours = [np.zeros(len(logs)), np.zeros(len(logs))]
    for side, scenes in enumerate((matched.a, matched.b)):
        for scene in scenes:
            hours[side][logs[scene.log_id]] += scene.hours
    counts = {side: np.zeros((len(logs), groups)) for side in ("a", "b")}
    for each in amounts:
        counts[each.side][logs[each.scene.log_id], each.group] += each.amount
    as_long = np.divide(hours[0], hours[1], out=np.zeros(len(logs)), where=hours[1] > 0)
    return over_logs(hours[0], counts["a"], counts["b"] * as_long[:, None], tolerance=tolerance)


def _on_roads(
    matched: Matched, amounts: Sequence[Amount], *, groups: int, tolerance: float
) -> Tested:
    sides = (("a", matched.a, matched.road_a), ("b", matched.b, matched.road_b))
    keys = sorted({(side, scene.log_id) for side, scenes, _ in sides for scene in scenes})
    logs = {key: at for at, key in enumerate(keys)}
    hours = np.zeros((matched.roads, len(logs)))
    road_of: dict[tuple[str, str], int] = {}
    for side, scenes, roads in sides:
        for scene, road in zip(scenes, roads.tolist(), strict=True):
            hours[road, logs[side, scene.log_id]] += scene.hours
            road_of[side, scene.scene_id] = road
    counts = np.zeros((matched.roads, len(logs), groups))
    for each in amounts:
        road = road_of[each.side, each.scene.scene_id]
        counts[road, logs[each.side, each.scene.log_id], each.group] += each.amount
    is_b = np.array([side == "b" for side, _ in keys])
    driven = [Road(hours[road], counts[road]) for road in range(matched.roads)]
    return over_roads(driven, is_b, tolerance=tolerance)
