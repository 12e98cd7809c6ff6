"""Facts of an overlay that its header states, and the pictures that its header describes."""

from typing import Any

import numpy as np

from schemas.overlay import Overlay, OverlayLidar
from schemas.overlay_picture import Picture
from schemas.transport.overlay_header import LidarEntry, PictureEntry


def facts_of(overlay: Overlay) -> dict[str, Any]:
    """Return the header without the places of the blocks."""
    boxes = [float(each) for each in overlay.instance_boxes.ravel().astype("U32")]
    lidars = [_lidar_facts(lidar) for lidar in overlay.lidars]
    return ({"lidars": lidars} if lidars else {}) | {
        "scene_id": overlay.scene_id,
        "task": overlay.task.name,
        "class_names": list(overlay.class_names),
        "frames": [
            {
                "stamp_ns": str(stamp_ns),
                "points": len(overlay.points_cm[overlay.points_of(frame)]),
                "odom_from_sensor": overlay.odom_from_sensor[frame].ravel().tolist(),
            }
            for frame, stamp_ns in enumerate(overlay.stamps_ns.tolist())
        ],
        "instances": {
            "frame": overlay.instance_frame.tolist(),
            "kind": overlay.instance_kind.tolist(),
            "track": overlay.instance_track.tolist(),
            "boxes": [boxes[at : at + 7] for at in range(0, len(boxes), 7)],
        },
        "pictures": [_picture_facts(picture) for picture in overlay.pictures],
    }


def _lidar_facts(lidar: OverlayLidar) -> dict[str, Any]:
    return {
        "topic": lidar.topic,
        "points": lidar.points.tolist(),
        "stamps_ns": [str(stamp_ns) for stamp_ns in lidar.stamps_ns.tolist()],
        "main_from_lidar": lidar.main_from_lidar.reshape(-1, 16).tolist(),
    }


def lidar_of(entry: LidarEntry) -> OverlayLidar:
    """Return the further lidar that an entry of a header describes."""
    return OverlayLidar(
        topic=entry.topic,
        points=np.array(entry.points, dtype=np.int64),
        stamps_ns=np.array([int(each) for each in entry.stamps_ns], dtype=np.int64),
        main_from_lidar=np.array(entry.main_from_lidar, dtype=np.float64).reshape(-1, 4, 4),
    )


def _picture_facts(picture: Picture) -> dict[str, Any]:
    calibration: dict[str, Any] = {
        "pixel_from_camera": picture.pixel_from_camera.ravel().tolist(),
        "camera_from_lidar": picture.camera_from_lidar.ravel().tolist(),
        "width": picture.width,
        "height": picture.height,
    }
    if picture.distortion:
        calibration["distortion_model"] = picture.distortion_model
        calibration["distortion"] = list(picture.distortion)
    return {
        "topic": picture.topic,
        "frame": picture.frame,
        "stamp_ns": str(picture.stamp_ns),
        "width": picture.width,
        "height": picture.height,
        "media_type": picture.media_type,
        "calibration": calibration,
        "tracks": list(picture.tracks),
    }


def picture_of(entry: PictureEntry, image_bytes: bytes) -> Picture:
    """Return the picture that an entry of a header describes."""
    known = entry.calibration
    return Picture(
        topic=entry.topic,
        frame=entry.frame,
        stamp_ns=int(entry.stamp_ns),
        width=entry.width,
        height=entry.height,
        media_type=entry.media_type,
        image_bytes=image_bytes,
        pixel_from_camera=np.array(known.pixel_from_camera).reshape(3, 4),
        camera_from_lidar=np.array(known.camera_from_lidar).reshape(4, 4),
        distortion_model=known.distortion_model,
        distortion=known.distortion,
        tracks=entry.tracks,
    )
