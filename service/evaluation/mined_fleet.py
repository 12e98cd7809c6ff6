"""Mined logs of a benchmark as candidates of a selection, with the failures that each shows.

The rows are those that `bench failures --kept` writes. They contain no software version and one
place per track, so that balance and twins of a fleet know less than those of a ledger.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import ValidationError

from schemas.arrays import NS_PER_S
from schemas.contradiction import InstanceRecord, TrackRecord
from schemas.events import MAX_LISTED_TRACKS, TrackSummary
from schemas.score import MIN_REPORTED_STRENGTH
from service.curation.candidates import Candidate
from service.curation.ranking import Neighbour, RankedScene
from service.curation.twins import ShownScene, Twins
from service.errors import NothingFoundError, UsageError
from workers.lab.evaluation.failures.rows import OTHER_KIND, MinedLog, ObjectRow, SceneRow, TrackRow

FRAME_NS: Final = NS_PER_S // 10
"""Frame period of the simulated lidars, nanoseconds."""

_FAR_M: Final = 80.0
_FAST_M_PER_S: Final = 10.0
"""Values of 1 of the evidence `distance` and `speed`, which the rows contain in their place."""

AGAIN: Final = "again-"
"""Begin of the log ids of repetitions."""

Failure = tuple[str, str, str]
"""A distinct failure: log, object, kind."""


@dataclass(frozen=True, slots=True)
class FleetScene:
    """A scene of a mined fleet.

    Attributes:
        candidate: As the ledger would list it, with its rank in this fleet.
        origin: Its log; of a repetition, the log that it repeats.
        failures: Distinct planted failures that it shows.
        failing: Of these, planted kind and true class.
        row: Its row.
    """

    candidate: Candidate
    origin: str
    failures: frozenset[Failure]
    failing: frozenset[tuple[str, str]]
    row: SceneRow


def read_logs(folder: Path) -> list[MinedLog]:
    """Read the mined logs of a folder.

    Raises:
        NothingFoundError: If it contains none.
        UsageError: If a file is no mined log.
    """
    files = sorted(folder.glob("*.json"))
    if not files:
        raise NothingFoundError(
            f"no mined logs in {folder}; `counterpoint bench failures --kept {folder}` writes them"
        )
    logs = []
    for file in files:
        try:
            logs.append(MinedLog.model_validate_json(file.read_text()))
        except (ValidationError, UnicodeDecodeError):
            raise UsageError(f"{file} is no mined log of this version; mine it again") from None
    return logs


def read_fleets(folders: Sequence[Path]) -> list[MinedLog]:
    """Read several fleets as one; vehicles of further fleets get other names.

    Raises:
        NothingFoundError: If one of the folders contains no mined log.
        UsageError: If a file is no mined log.
    """
    found = []
    for number, folder in enumerate(folders):
        logs = read_logs(folder)
        found += [_named(log, f"{number}-{log.log_id}") for log in logs] if number else logs
    return found


def _named(log: MinedLog, log_id: str) -> MinedLog:
    scenes = [
        scene.model_copy(update={"scene_id": log_id + scene.scene_id.removeprefix(log.log_id)})
        for scene in log.scenes
    ]
    return log.model_copy(update={"log_id": log_id, "scenes": tuple(scenes)})


def fleet_of(logs: Iterable[MinedLog]) -> list[FleetScene]:
    """Rank the scenes of mined logs, best first, with their twins."""
    shown = [(log, number, _shown(log, row)) for log in logs for number, row in _ordered(log)]
    order = sorted(shown, key=lambda each: (-_score(each[0].scenes[each[1]]), each[2].at.start_ns))
    around = {log.log_id: _ordered(log) for log, _, _ in shown}
    twins, found = Twins(), []
    for rank, (log, number, scene) in enumerate(order, start=1):
        row = log.scenes[number]
        rows = [each for _, each in around[log.log_id]]
        at = rows.index(row)
        near = [
            _neighbour(rows[each]) if 0 <= each < len(rows) else None for each in (at - 1, at + 1)
        ]
        ranked = RankedScene(
            rank=rank,
            scene_id=row.scene_id,
            log_id=log.log_id,
            start_ns=row.start_ns,
            end_ns=scene.at.end_ns,
            score=_score(row),
            tracks=tuple(TrackSummary.of(each) for each in scene.tracks[:MAX_LISTED_TRACKS]),
            twin_of=twins.twin_of(scene, near) if scene.tracks else None,
            sha256="0" * 64,
        )
        failing = [each for each in row.failing if each.kind != OTHER_KIND]
        found.append(
            FleetScene(
                candidate=Candidate(ranked, vehicle=log.log_id.partition("/")[0]),
                origin=origin_of(log.log_id),
                failures=frozenset(
                    (origin_of(log.log_id), _name_of(each), each.kind) for each in failing
                ),
                failing=frozenset((each.kind, each.class_name) for each in failing),
                row=row,
            )
        )
    return found


def _name_of(thing: ObjectRow) -> str:
    return str(thing.track) if thing.track >= 0 else thing.key


def origin_of(log_id: str) -> str:
    """Return the log that a repetition repeats; other logs are their own origin."""
    return log_id.partition("/")[2] if log_id.startswith(AGAIN) else log_id


def _ordered(log: MinedLog) -> list[tuple[int, SceneRow]]:
    return sorted(enumerate(log.scenes), key=lambda each: each[1].start_ns)


def _score(row: SceneRow) -> float:
    return row.score if row.state == "scored" else 0.0


def _neighbour(row: SceneRow) -> Neighbour:
    return Neighbour(row.scene_id, row.start_ns, row.start_ns + round(row.seconds * NS_PER_S))


def _shown(log: MinedLog, row: SceneRow) -> ShownScene:
    strong = sorted(
        (each for each in row.tracks if each.strength >= MIN_REPORTED_STRENGTH),
        key=lambda each: -each.strength,
    )
    tracks = tuple(track_of(each, row, number) for number, each in enumerate(strong))
    if _score(row) < MIN_REPORTED_STRENGTH:
        tracks = ()
    return ShownScene(_neighbour(row), log.log_id, driven_m=0.0, tracks=tracks)


def track_of(track: TrackRow, row: SceneRow, number: int) -> TrackRecord:
    """Return the record of a track as far as its row contains it: one place, at its middle frame.

    In rows of earlier revisions the class is unknown, and the centre is the distance along the x
    axis, since the bearing is unknown.
    """
    middle = max(track.first_frame, 0) + track.frames // 2
    stamp_ns = row.start_ns + middle * FRAME_NS
    far_m = track.evidence.get("distance", 0.0) * _FAR_M
    centre_m = track.strongest_m or (far_m, 0.0, 0.0)
    speed_m_per_s = track.speed_m_per_s
    if speed_m_per_s is None:
        speed_m_per_s = track.evidence.get("speed", 0.0) * _FAST_M_PER_S
    return TrackRecord(
        track_id=number,
        kind=track.kind,
        class_name=track.class_name,
        strength=track.strength,
        first_ns=stamp_ns,
        last_ns=stamp_ns,
        frames=max(track.frames, 1),
        points=max(track.points, 1),
        speed_m_per_s=speed_m_per_s,
        first_odom_m=track.place_m,
        last_odom_m=track.place_m,
        attribution=track.said,
        strongest=InstanceRecord(
            stamp_ns=stamp_ns,
            points=max(track.points, 1),
            centre_m=centre_m,
            size_m=track.size_m or (0.0, 0.0, 0.0),
            yaw_rad=0.0,
            range_m=math.hypot(centre_m[0], centre_m[1]),
            semantic_confidence=0.0,
            predictive_confidence=0.0,
        ),
    )


def recurring(logs: Iterable[MinedLog], *, times: int, seed: int = 0) -> list[MinedLog]:
    """Repeat each log, as if other cars met the same failures.

    The repetitions have their own log ids, so that no twin is found between them. Scores and
    strengths are disturbed by 20 %, sizes by 15 %, distance and speed by 50 % (one standard
    deviation). The failures keep the names of the first: they are found once.
    """
    rng = np.random.default_rng(seed)

    def off(value: float, share: float, most: float = 1.0) -> float:
        return float(np.clip(value * (1.0 + share * rng.standard_normal()), 0.0, most))

    def seen_again(track: TrackRow) -> TrackRow:
        evidence = {
            name: off(value, 0.5) if name in ("distance", "speed") else value
            for name, value in track.evidence.items()
        }
        size_m = track.size_m and tuple(off(each, 0.15, 100.0) for each in track.size_m)
        far = off(1.0, 0.5, 3.0)
        strongest_m = track.strongest_m and tuple(far * each for each in track.strongest_m)
        speed = track.speed_m_per_s and off(track.speed_m_per_s, 0.5, 100.0)
        strength = off(track.strength, 0.2)
        return track.model_copy(
            update={
                "evidence": evidence,
                "size_m": size_m,
                "strength": strength,
                "strongest_m": strongest_m,
                "speed_m_per_s": speed,
            }
        )

    found = []
    for log in logs:
        found.append(log)
        for number in range(1, times):
            scenes = [
                scene.model_copy(
                    update={
                        "scene_id": f"{AGAIN}{number}/{scene.scene_id}",
                        "score": off(scene.score, 0.2),
                        "tracks": tuple(seen_again(track) for track in scene.tracks),
                    }
                )
                for scene in log.scenes
            ]
            found.append(
                log.model_copy(
                    update={"log_id": f"{AGAIN}{number}/{log.log_id}", "scenes": tuple(scenes)}
                )
            )
    return found
