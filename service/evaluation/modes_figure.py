"""Modes of a mined fleet against its planted kinds, and their ids as the fleet doubles."""

from collections.abc import Sequence
from dataclasses import replace

from pydantic import BaseModel, ConfigDict, Field
from sklearn.metrics import adjusted_mutual_info_score

from schemas.arrays import NS_PER_S
from schemas.events import TrackSummary
from service.curation.modes import Mode, ModeTrack, modes_of, tracks_of
from service.evaluation.mined_fleet import FRAME_NS, fleet_of, track_of
from workers.lab.evaluation.failures.rows import OTHER_KIND, MinedLog


class ModesFigure(BaseModel):
    """Fit of modes to planted kinds, and their stability."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    tracks: int = Field(description="Strong tracks on which the supervised stream errs.")
    in_modes: float = Field(description="Share of them in a mode.")
    modes: int
    planted: int = Field(description="Of the tracks in a mode, those on a planted failure.")
    kinds: int = Field(description="Planted kinds of these.")
    ami: float | None = Field(
        description="Adjusted mutual information of modes and planted kinds over these."
    )
    ami_by_class: float | None = Field(
        description="The same of modes and planted kinds together with the labelled class."
    )
    kept: float | None = Field(
        description="Share of the members of modes of the first half of the logs that have the "
        "same id in the whole fleet; null: the half has no mode."
    )


def modes_figure(logs: Sequence[MinedLog]) -> ModesFigure:
    """Measure modes on mined logs; scenes come in the order of the logs."""
    kinds, tracks = _tracks(logs)
    modes = modes_of(tracks)
    of = _ids(modes)
    planted = [each for each in tracks if kinds[each.key] and each.key in of]
    found = [of[each.key] for each in planted]
    truth = [kinds[each.key] for each in planted]
    of_classes = [f"{kinds[each.key]} {each.track.class_name}" for each in planted]
    _, earlier = _tracks(logs[: len(logs) // 2])
    members = _ids(modes_of(earlier))
    return ModesFigure(
        tracks=len(tracks),
        in_modes=round(len(of) / max(1, len(tracks)), 4),
        modes=len(modes),
        planted=len(planted),
        kinds=len(set(truth)),
        ami=_rounded(adjusted_mutual_info_score(truth, found)) if planted else None,
        ami_by_class=_rounded(adjusted_mutual_info_score(of_classes, found)) if planted else None,
        kept=_rounded(sum(of.get(key) == mode for key, mode in members.items()) / len(members))
        if members
        else None,
    )


def _tracks(logs: Sequence[MinedLog]) -> tuple[dict[str, str], list[ModeTrack]]:
    """Return the planted kind of every strong track, by its key, and those that modes take."""
    order = {log.log_id: number for number, log in enumerate(logs)}
    kinds: dict[str, str] = {}
    candidates = []
    for each in fleet_of(logs):
        rows = sorted(each.row.tracks, key=lambda track: -track.strength)
        planted = {one.key: one.kind for one in each.row.failing if one.kind != OTHER_KIND}
        listed = []
        for number in range(len(each.candidate.scene.tracks)):
            row = rows[number]
            record = track_of(row, each.row, number)
            listed.append(
                TrackSummary.of(record).model_copy(
                    update={"last_ns": record.first_ns + row.frames * FRAME_NS}
                )
            )
            kinds[f"{each.candidate.scene.scene_id}#{number}"] = planted.get(row.thing, "")
        scene = each.candidate.scene.model_copy(update={"tracks": tuple(listed)})
        seq = order[scene.log_id] * 10_000 + scene.start_ns // NS_PER_S % 10_000
        candidates.append(replace(each.candidate, scene=scene, seq=seq))
    return kinds, tracks_of(candidates)


def _ids(modes: Sequence[Mode]) -> dict[str, str]:
    return {member.key: mode.mode_id for mode in modes for member in mode.members}


def _rounded(value: float) -> float:
    return round(float(value), 4)
