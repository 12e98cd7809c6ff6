"""Facts of a scene for the viewer in the browser: frames, tracks, pictures and colours. Pure."""

from collections.abc import Sequence
from typing import Any, Final

from schemas.arrays import NS_PER_S
from schemas.attribution import Wrong
from schemas.contradiction import TrackRecord
from schemas.score import MIN_REPORTED_STRENGTH, SceneScore
from schemas.task import Task, task_named
from schemas.transport.overlay_header import OverlayHeader, PictureEntry
from service.pictures.style import Colour, colours_of, inks_of, meaning
from service.web.phrases import wrong_name

SAFE_COLOURS: Final[tuple[Colour, ...]] = (
    (118, 124, 132),
    (240, 170, 10),
    (60, 160, 255),
    (225, 225, 235),
    (74, 78, 84),
)
"""Colours of the outcomes of two classes that colour-blind reviewers can distinguish (after
Okabe and Ito): grey, orange, blue, white, and dark grey where not compared.
"""

SAFE_WITNESS: Final[Colour] = (204, 121, 167)

BOX_DIGITS: Final = 3
POSE_DIGITS: Final = 6
"""Digits of a pose's numbers: a micrometre, since far points multiply the error of a rotation."""


def viewer_facts(score: SceneScore, header: OverlayHeader) -> dict[str, Any]:
    """Return all that the viewer needs in addition to the blocks, ready for JSON.

    Only tracks of the record have boxes: all tracks of a busy scene at once are unreadable.
    """
    task = task_named(score.task)
    instances, known = header.instances, {track.track_id for track in score.tracks}
    stamps_ns = [int(frame.stamp_ns) for frame in header.frames]
    boxes: dict[int, list[list[float]]] = {track_id: [] for track_id in known}
    for frame, track, box in zip(instances.frame, instances.track, instances.boxes, strict=True):
        if track in known:
            boxes[track].append([frame, *(round(value, BOX_DIGITS) for value in box)])
    return {
        "task": {"classes": list(task.classes), "outcomes": outcomes_of(task)},
        "frames": [
            {
                "seconds": round((int(frame.stamp_ns) - score.start_ns) / NS_PER_S, 3),
                "points": frame.points,
                "pose": [round(value, POSE_DIGITS) for value in frame.odom_from_sensor],
            }
            for frame in header.frames
        ],
        "owners": [track if track in known else -1 for track in instances.track],
        "tracks": [
            _track_facts(track, task, sorted(boxes[track.track_id]))
            | {"frame": frame_at(track.strongest.stamp_ns, stamps_ns)}
            for track in score.tracks
            if boxes[track.track_id]
        ],
        "pictures": [_picture_facts(entry, known) for entry in header.pictures],
        "start": start_frame(score, stamps_ns),
    }


def start_frame(score: SceneScore, stamps_ns: Sequence[int]) -> int:
    """Return the frame with the most evidence of the strongest track; else the middle one."""
    if not score.tracks:
        return len(stamps_ns) // 2
    return frame_at(score.tracks[0].strongest.stamp_ns, stamps_ns)


def frame_at(stamp_ns: int, stamps_ns: Sequence[int]) -> int:
    """Return the index of the frame that is nearest in time."""
    return min(range(len(stamps_ns)), key=lambda frame: abs(stamps_ns[frame] - stamp_ns))


def outcomes_of(task: Task) -> list[dict[str, Any]]:
    """Return name, meaning and colours of each outcome of a task, by code."""
    colours = colours_of(task)
    safe = dict(enumerate(SAFE_COLOURS)) if len(task.classes) == 2 else colours
    return [
        {
            "name": outcome.name,
            "meaning": meaning(outcome, task),
            "colour": colours[outcome.code],
            "safe": safe[outcome.code],
            "contradicts": outcome.contradicts,
        }
        for outcome in task.outcomes
    ]


def label_of(track: TrackRecord) -> str:
    """Return number and class of a track, the same as on all pictures."""
    return f"{track.track_id + 1} {track.class_name or 'object'}"


def attribution_of(track: TrackRecord) -> str:
    """Return who errs and the probability, in words; empty without an attribution."""
    found = track.attribution
    if found is None:
        return ""
    return f"{wrong_name(Wrong(found.wrong).value)} {found.chance:.0%}".replace("%", " %")


def _track_facts(track: TrackRecord, task: Task, boxes: list[list[float]]) -> dict[str, Any]:
    kind = task.kind(track.kind)
    safe = dict(enumerate(SAFE_COLOURS)) if len(task.classes) == 2 else inks_of(task)
    return {
        "id": track.track_id,
        "label": label_of(track),
        "verdict": attribution_of(track),
        "strong": track.strength >= MIN_REPORTED_STRENGTH,
        "witness": kind.of_witness,
        "ink": inks_of(task)[kind.code],
        "safe": SAFE_WITNESS if kind.of_witness else safe[kind.code],
        "boxes": boxes,
    }


def _picture_facts(entry: PictureEntry, known: set[int]) -> dict[str, Any]:
    calibration = entry.calibration
    return {
        "topic": entry.topic,
        "frame": entry.frame,
        "width": entry.width,
        "height": entry.height,
        "pixel": list(calibration.pixel_from_camera),
        "camera": list(calibration.camera_from_lidar),
        "model": calibration.distortion_model,
        "lens": list(calibration.distortion),
        "tracks": [track for track in entry.tracks if track in known],
    }
