"""The frame and the camera that see the first track, as in the paper's review."""

from typing import TYPE_CHECKING, Final

from PIL import Image

from schemas.arrays import NS_PER_S
from schemas.overlay import Overlay
from schemas.overlay_picture import Picture
from schemas.score import SceneScore
from schemas.sights import sights_of
from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.recordings import group_recordings
from schemas.work import Recording
from service.errors import NothingFoundError, UsageError
from service.pictures.camera import draw_camera
from service.pictures.camera_boxes import boxes_of
from service.pictures.scene import strongest_frame
from service.pictures.title import Title, labels_of
from service.settings.config import Settings

if TYPE_CHECKING:
    from workers.ingest.camera_model import CameraView

MOST_LOOKS: Final = 8
"""Tracks that are searched in the images."""

MOST_READS: Final = 4
"""Frames whose images are read; each takes one or two chunks of the log."""


def draw_on_camera(
    score: SceneScore, overlay: Overlay, settings: Settings, *, title: Title
) -> Image.Image:
    """Draw a scene on the camera image that sees its first track; else the next one that is seen.

    A picture that was kept with the scene is used where one sees a track. Otherwise all cameras of
    the log are searched, in every frame of the track. Apart from `inspect` and `score`, this is
    then the only verb that opens a log; it needs the extra `workers`.

    Raises:
        UsageError: If no picture was kept, and no log bucket is named.
        NothingFoundError: If the scene's log is no longer in it.
        CameraUnavailableError: If the log has no calibrated camera that saw the frame.
    """
    kept = _kept(score, overlay)
    if kept is not None:
        picture, track_id = kept
        return _drawn(score, overlay, view_of(picture), picture.frame, title, track_id=track_id)
    from workers.ingest.camera import CameraReader

    cameras = CameraReader(*_log_of(score, settings), lidar_topic=score.lidar_topic)

    def views_at(frame: int) -> "list[CameraView]":
        return cameras.views_at(int(overlay.stamps_ns[frame]))

    start = strongest_frame(score, overlay)
    read = {start: views_at(start)}
    for sight in sights_of(score.tracks[:MOST_LOOKS], overlay, read[start]):
        if sight.frame not in read:
            if len(read) == MOST_READS:
                break
            read[sight.frame] = views_at(sight.frame)
        for view in read[sight.frame]:
            if view.topic == sight.topic:
                return _drawn(score, overlay, view, sight.frame, title, track_id=sight.track_id)
    ahead = max(read[start], key=lambda view: float(view.camera_from_lidar[2, 0]))
    return _drawn(score, overlay, ahead, start, title, track_id=None)


def view_of(picture: Picture) -> "CameraView":
    """Return the projection into a kept picture."""
    from workers.ingest.camera_model import CameraView

    return CameraView(
        topic=picture.topic,
        stamp_ns=picture.stamp_ns,
        image_bytes=picture.image_bytes,
        image_format=picture.media_type,
        width=picture.width,
        height=picture.height,
        pixel_from_camera=picture.pixel_from_camera,
        distortion_model=picture.distortion_model,
        distortion=picture.distortion,
        camera_from_lidar=picture.camera_from_lidar,
    )


def _kept(score: SceneScore, overlay: Overlay) -> tuple[Picture, int] | None:
    """Return the kept picture of the first track that one sees, nearest to its strongest frame."""
    for track in score.tracks[:MOST_LOOKS]:
        seen = [each for each in overlay.pictures if track.track_id in each.tracks]
        if seen:
            strongest_ns = track.strongest.stamp_ns
            apart_ns = [abs(int(overlay.stamps_ns[each.frame]) - strongest_ns) for each in seen]
            return seen[apart_ns.index(min(apart_ns))], track.track_id
    return None


def _log_of(score: SceneScore, settings: Settings) -> tuple[Bucket, Recording]:
    if not settings.bucket:
        raise UsageError(
            "no picture was kept with the scene, so --on-image reads the log: name its bucket with "
            "--bucket URL"
        )
    bucket = open_bucket(settings.bucket)
    folder = score.log_id.rpartition("/")[0]
    recordings = {found.log_id: found for found in group_recordings(bucket.list(prefix=folder))}
    if score.log_id not in recordings:
        raise NothingFoundError(f"no log {score.log_id} in {bucket.url}")
    return bucket, recordings[score.log_id]


def _drawn(
    score: SceneScore,
    overlay: Overlay,
    view: "CameraView",
    frame: int,
    title: Title,
    *,
    track_id: int | None,
) -> Image.Image:
    at_px, inside_mask = view.project(overlay.points_m(frame))
    return draw_camera(
        view.image_bytes,
        overlay,
        frame=frame,
        at_px=at_px,
        inside_mask=inside_mask,
        boxes=boxes_of(overlay, frame, view, labels=labels_of(score), shown_track=track_id),
        title=[f"{title.text} | {_where(overlay, view, frame)}", *_lines(score, track_id)],
    )


def _where(overlay: Overlay, view: "CameraView", frame: int) -> str:
    at_s = (int(overlay.stamps_ns[frame]) - int(overlay.stamps_ns[0])) / NS_PER_S
    return f"{view.topic}, frame {frame} at {at_s:.1f} s"


def _lines(score: SceneScore, track_id: int | None) -> list[str]:
    """Return the headline of the scene, and a line if the image shows another track than its."""
    headline = score.reasons[0].headline if score.reasons else "no contradiction in this scene"
    if not score.tracks or track_id == 0:
        return [f"1  {headline}" if score.tracks else headline]
    if track_id is None:
        return [f"1  {headline}", "no strong track is in the view of a camera; the road ahead"]
    shown = [each.headline for each in score.reasons if each.track_id == track_id]
    return [
        f"1  {headline} (in no camera's view)",
        f"{track_id + 1}  {shown[0] if shown else 'shown instead'}",
    ]
