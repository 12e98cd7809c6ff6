"""Format `rerun`: a recording for each scene with a blueprint, for Rerun's viewer.

The points have the colours of the outcomes and the boxes their tracks, in the space in which the
poses of mining are. Camera images are in excerpts (`mcap`), which Rerun opens as well.
"""

import hashlib
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.overlay import Overlay
from schemas.score import SceneScore
from service.errors import UsageError
from service.export.format import Format
from service.export.points import LabelledCloud
from service.export.rotation import quaternion_wxyz
from service.export.scene import SceneToExport
from service.pictures.style import colours_of, inks_of, meaning

Place = NDArray[np.float64]

APPLICATION: Final = "counterpoint"
TIMELINE: Final = "stamp"
SENSOR: Final = "odom/lidar"
POINTS: Final = f"{SENSOR}/points"
BOXES: Final = f"{SENSOR}/boxes"
REASONS: Final = "reasons"
RECORD: Final = "record"

_POINT_PX: Final = 1.2
"""Radius of a point on the screen, in points of the user interface."""

_NIGHT: Final = (16, 18, 22)
"""Colour of space: the four colours have more contrast on it than on white."""

_AWAY_M: Final = 11.0
_ABOVE_M: Final = 5.0
"""Distance of the first view from the strongest track, towards the car and up: a street's width."""


def need_rerun() -> None:
    """Refuse where Rerun's SDK is not installed."""
    if find_spec("rerun") is None:
        raise UsageError("format rerun needs Rerun's SDK: install 'counterpoint[rerun]'")


def write_scene(scene: SceneToExport, path: Path) -> None:
    """Write the recording of one scene.

    Raises:
        PermanentError: If the log is gone, or no longer has the frames.
    """
    import rerun as rr

    score, overlay = scene.score, scene.overlay
    number = hashlib.sha256(f"{score.scene_id} {scene.sha256}".encode()).hexdigest()[:32]
    recording = rr.RecordingStream(APPLICATION, recording_id=number)
    recording.save(path, default_blueprint=_blueprint(scene))
    recording.send_recording_name(scene.stem)
    names = [
        rr.AnnotationInfo(id=outcome.code, label=meaning(outcome, overlay.task), color=colour)
        for outcome in overlay.task.outcomes
        for colour in [colours_of(overlay.task)[outcome.code]]
    ]
    recording.log("/", rr.AnnotationContext(names), static=True)
    recording.log("odom", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log(
        RECORD, rr.TextDocument(_document(scene), media_type="text/markdown"), static=True
    )
    for cloud in scene.clouds():
        recording.set_time(TIMELINE, timestamp=np.datetime64(cloud.stamp_ns, "ns"))
        if cloud.number == 0:
            for reason in score.reasons:
                recording.log(REASONS, rr.TextLog(reason.text, level="INFO"))
        _log_frame(rr, recording, scene, cloud)
    recording.flush()
    recording.disconnect()


def _log_frame(rr: Any, recording: Any, scene: SceneToExport, cloud: LabelledCloud) -> None:
    overlay = scene.overlay
    tracks = {track.track_id: track for track in scene.score.tracks}
    pose = cloud.odom_from_sensor
    recording.log(SENSOR, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    recording.log(
        POINTS,
        rr.Points3D(cloud.points_m, class_ids=cloud.category, radii=rr.Radius.ui_points(_POINT_PX)),
        rr.AnyValues(index=cloud.raw_index, track=cloud.track, label=cloud.label),
    )
    found = overlay.instances_of(cloud.number)
    boxes = overlay.instance_boxes[found]
    numbers = overlay.instance_track[found].tolist()
    inks = inks_of(overlay.task)
    turned = [_xyzw(float(yaw)) for yaw in boxes[:, 6]]
    labels = [
        f"{number + 1} {tracks[number].class_name or 'object'}" if number in tracks else ""
        for number in numbers
    ]
    recording.log(
        BOXES,
        rr.Boxes3D(
            centers=boxes[:, :3],
            sizes=boxes[:, 3:6],
            quaternions=turned,
            labels=labels,
            colors=[inks[int(kind)] for kind in overlay.instance_kind[found]],
            show_labels=False,
        ),
    )


def _blueprint(scene: SceneToExport) -> Any:
    """Return the layout of the viewer: the space, the record next to it, the reasons below."""
    import rerun.blueprint as rrb

    view = first_view(scene.score, scene.overlay)
    space = rrb.Spatial3DView(
        origin="odom",
        name=scene.stem,
        background=_NIGHT,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=view[0], look_target=view[1]) if view else None,
    )
    record = rrb.TextDocumentView(origin=RECORD, name="record")
    reasons = rrb.TextLogView(origin=REASONS, name="reasons")
    texts = rrb.Vertical(record, reasons, row_shares=[3, 1])
    return rrb.Blueprint(
        rrb.Horizontal(space, texts, column_shares=[3, 1]),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state="playing",
            loop_mode="all",
            playback_speed=0.5,
        ),
        collapse_panels=True,
    )


def first_view(score: SceneScore, overlay: Overlay) -> tuple[Place, Place] | None:
    """Return where the eye begins and what it looks at: the strongest track, from the car's side.

    Args:
        score: Record of the scene.
        overlay: Its overlay.

    Returns:
        Two places of odom space, (3,), metres; None in a scene without contradictions.
    """
    if not score.tracks:
        return None
    members = np.flatnonzero(overlay.instance_track == score.tracks[0].track_id)
    if not len(members):
        return None
    stamps_ns = overlay.stamps_ns[overlay.instance_frame[members]]
    best = members[int(np.argmin(np.abs(stamps_ns - score.tracks[0].strongest.stamp_ns)))]
    pose = overlay.odom_from_sensor[overlay.instance_frame[best]]
    seen_m = pose[:3, :3] @ overlay.instance_boxes[best, :3] + pose[:3, 3]
    towards = pose[:2, 3] - seen_m[:2]
    towards /= max(float(np.linalg.norm(towards)), 1.0)
    return seen_m + np.array([*(_AWAY_M * towards), _ABOVE_M]), seen_m


def _document(scene: SceneToExport) -> str:
    score = scene.score
    reasons = "".join(f"1. {reason.headline}\n" for reason in score.reasons)
    verdicts = "".join(
        f"- {each.reviewer}: {each.verdict}"
        f"{'' if each.track_id is None else f' (track {each.track_id + 1})'}\n"
        for each in scene.verdicts
    )
    return (
        f"# {score.score:.3f}\n\n`{score.scene_id}`\n\n{score.vehicle}, {score.date}, "
        f"{score.software_version}\n\n{reasons}\n{verdicts}"
    )


def _xyzw(yaw_rad: float) -> list[float]:
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    w, x, y, z = quaternion_wxyz(np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]]))
    return [x, y, z, w]


RERUN: Final = Format(
    name="rerun",
    text="A recording of Rerun for each scene, with a blueprint.",
    ending=".rrd",
    write_scene=write_scene,
    reads_logs=True,
    check=need_rerun,
)
"""Opened by `rerun FILE`, in a window or in a browser."""
