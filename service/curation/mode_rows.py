"""Rows of failure modes: how often each occurs, where, whether it grows, and its best examples."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import NS_PER_S
from schemas.bounds import MAX_LISTED, Count, Finite, Kept, Said, StampNs
from schemas.contradiction import KindName
from schemas.score import Share
from service.curation.modes import Mode, ModeTrack

DAY_NS: Final = 86_400 * NS_PER_S
HOUR_NS: Final = 3600 * NS_PER_S

MOST_NAMED: Final = 10
"""Vehicles and software versions that are named, the most frequent."""

EXAMPLES: Final = 3


class ModeExample(BaseModel):
    """A track that shows a mode."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scene_id: Kept
    track_id: Count = Field(description="As in the record of the scene.")
    strength: Share
    rank: Count = Field(description="Rank of the scene.")


class Occurrences(BaseModel):
    """Tracks of a mode of one vehicle or software version."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Said
    tracks: Count


class ModeRow(BaseModel):
    """One failure mode of the current scenes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    mode_id: Said = Field(description="Stays as scenes are added.")
    name: Said = Field(description="Its first members in a few words; stays too.")
    kind: KindName
    tracks: Count = Field(description="Strong tracks on which the supervised stream errs.")
    scenes: Count = Field(description="Scenes with one of them.")
    per_hour: Finite = Field(description="Tracks per hour driven.")
    earlier_per_hour: Finite = Field(
        description="The same over the days of the first half of the hours."
    )
    later_per_hour: Finite | None = Field(
        description="The same over the days after them; null: all were driven on one day."
    )
    first_ns: StampNs = Field(description="Begin of the earliest scene, ns since the epoch.")
    last_ns: StampNs = Field(description="Begin of the latest scene.")
    vehicles: tuple[Occurrences, ...] = Field(
        max_length=MOST_NAMED, description="Most frequent first."
    )
    software_versions: tuple[Occurrences, ...] = Field(
        max_length=MOST_NAMED, description="Most frequent first."
    )
    examples: tuple[ModeExample, ...] = Field(
        max_length=EXAMPLES, description="Strongest first, each of another scene."
    )


class ModesReply(BaseModel):
    """The failure modes of the current scenes, the most frequent first."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    modes: tuple[ModeRow, ...] = Field(fail_fast=True, max_length=MAX_LISTED)
    tracks: Count = Field(description="Strong tracks on which the supervised stream errs.")
    without: Count = Field(description="Of them, those of no mode.")
    hours: Finite = Field(description="Hours driven in current scenes.")


def modes_reply(modes: Sequence[Mode], *, tracks: int, driven_ns: Mapping[int, int]) -> ModesReply:
    """Make the rows of modes.

    Args:
        modes: Modes of the current scenes.
        tracks: Tracks that were grouped, in a mode or not.
        driven_ns: Time driven in all current scenes by day since the Unix epoch, nanoseconds.
    """
    hours_ns = sum(driven_ns.values())
    split = _split_day(driven_ns)
    return ModesReply(
        modes=tuple(_row(mode, driven_ns, split) for mode in modes),
        tracks=tracks,
        without=tracks - sum(len(mode.members) for mode in modes),
        hours=round(hours_ns / HOUR_NS, 4),
    )


def _split_day(driven_ns: Mapping[int, int]) -> int:
    """Return the first day of the later half of the hours driven."""
    so_far = 0
    for day in sorted(driven_ns):
        so_far += driven_ns[day]
        if 2 * so_far >= sum(driven_ns.values()):
            return day + 1
    return 0


def _row(mode: Mode, driven_ns: Mapping[int, int], split: int) -> ModeRow:
    members = mode.members
    begins = [each.candidate.scene.start_ns for each in members]
    earlier = [begin for begin in begins if begin // DAY_NS < split]
    first_ns = sum(ns for day, ns in driven_ns.items() if day < split)
    later_ns = sum(driven_ns.values()) - first_ns
    return ModeRow(
        mode_id=mode.mode_id,
        name=mode.name,
        kind=members[0].track.kind,
        tracks=len(members),
        scenes=len({each.candidate.scene.scene_id for each in members}),
        per_hour=_per_hour(len(members), first_ns + later_ns),
        earlier_per_hour=_per_hour(len(earlier), first_ns),
        later_per_hour=_per_hour(len(members) - len(earlier), later_ns) if later_ns else None,
        first_ns=min(begins),
        last_ns=max(begins),
        vehicles=_occurrences(each.candidate.vehicle for each in members),
        software_versions=_occurrences(each.candidate.software_version for each in members),
        examples=_examples(members),
    )


def _per_hour(count: int, driven_ns: int) -> float:
    return round(count * HOUR_NS / driven_ns, 4) if driven_ns else 0.0


def _occurrences(names: Iterable[str]) -> tuple[Occurrences, ...]:
    counts = Counter(name for name in names if name)
    common = sorted(counts.items(), key=lambda each: (-each[1], each[0]))[:MOST_NAMED]
    return tuple(Occurrences(name=name, tracks=count) for name, count in common)


def _examples(members: Sequence[ModeTrack]) -> tuple[ModeExample, ...]:
    found: dict[str, ModeExample] = {}
    for each in sorted(members, key=lambda one: (-one.track.strength, one.key)):
        scene = each.candidate.scene
        if len(found) < EXAMPLES and scene.scene_id not in found:
            found[scene.scene_id] = ModeExample(
                scene_id=scene.scene_id,
                track_id=each.track.track_id,
                strength=each.track.strength,
                rank=scene.rank,
            )
    return tuple(found.values())
