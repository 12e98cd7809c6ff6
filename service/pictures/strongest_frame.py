"""Strongest frame of a scene on the camera image, as in the paper's review."""

from typing import Final

import numpy as np
from PIL import Image

from schemas.overlay import Overlay
from schemas.score import SceneScore
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from service.errors import NothingFoundError, UsageError
from service.pictures.camera import draw_camera
from service.pictures.scene import frame_of, strongest_frame
from service.settings.config import Settings

MOST_LOOKS: Final = 8
"""Tracks that are searched in an image; each attempt reads one or two chunks of the log."""


def draw_on_camera(score: SceneScore, overlay: Overlay, settings: Settings) -> Image.Image:
    """Fetch the camera image of the strongest visible contradiction, and draw the points on it.

    Apart from `inspect` and `score`, this is the only verb that opens a log; it needs the extra
    `workers`.

    Raises:
        UsageError: If no log bucket is named.
        NothingFoundError: If the scene's log is no longer in it.
        CameraUnavailableError: If the log has no calibrated camera that saw the frame.
    """
    from workers.ingest.camera import read_camera

    if not settings.bucket:
        raise UsageError("--on-image reads the log: name its bucket with --bucket URL")
    bucket = open_bucket(settings.bucket)
    folder = score.log_id.rpartition("/")[0]
    recordings = {found.log_id: found for found in group_recordings(bucket.list(prefix=folder))}
    if score.log_id not in recordings:
        raise NothingFoundError(f"no log {score.log_id} in {bucket.url}")
    recording = recordings[score.log_id]
    looks = _looks(score, overlay)
    for frame, look_at_m in looks:
        seen = read_camera(
            bucket,
            recording,
            lidar_topic=score.lidar_topic,
            stamp_ns=int(overlay.stamps_ns[frame]),
            look_at_m=look_at_m,
        )
        in_view = bool(seen.project(np.array([look_at_m], dtype=np.float32))[1][0])
        if in_view or (frame, look_at_m) == looks[-1]:
            at_px, inside_mask = seen.project(overlay.points_m(frame))
            return draw_camera(
                seen.image_bytes, overlay, frame=frame, at_px=at_px, inside_mask=inside_mask
            )
    raise AssertionError("the road ahead is always looked at")


def _looks(score: SceneScore, overlay: Overlay) -> list[tuple[int, tuple[float, float, float]]]:
    """Return frames and target points in them, strongest first; the last is the road ahead.

    A car may have a front camera only, so the first visible contradiction is drawn.
    """
    contradictions = [
        (frame_of(track, overlay), track.strongest.centre_m) for track in score.tracks[:MOST_LOOKS]
    ]
    return [*contradictions, (strongest_frame(score, overlay), (10.0, 0.0, 0.0))]
