"""A state whose scenes have points, tracks and a camera picture that the scene page can show."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from schemas.attribution import Attribution, Wrong
from schemas.overlay import Overlay
from schemas.overlay_picture import Picture
from schemas.score import Reason
from schemas.task import MOTION
from schemas.transport.overlay_codec import decode_overlay, encode_overlay
from service.api.state_reader import StateReader
from service.settings.config import load_settings
from tests.factories import track_record
from tests.overlays import labels_of_points
from tests.unit.service.mined_state import mined_state

FRAMES = 5
WALL, CAR = 3000, 60
NAMES = ("car", "pedestrian")


def two_tracks() -> dict[str, Any]:
    """Fields of a record with two strong tracks, whose attributions are known."""
    tracks = [
        track_record(
            track_id=number,
            class_name=name,
            strength=0.5 - 0.2 * number,
            kind=MOTION.kinds[1 - number].name,
            attribution=Attribution(
                wrong=Wrong.SUPERVISED,
                supervised=0.9,
                selfsupervised=0.05,
                both=0.02,
                neither=0.03,
                supporting=("motion in bulk", "arrival from elsewhere"),
                opposing=("long range",),
            ),
        )
        for number, name in enumerate(NAMES)
    ]
    reasons = [
        Reason(headline=f"supervised labels {name} static", track_id=n)
        for n, name in enumerate(NAMES)
    ]
    return {"tracks": tuple(tracks), "reasons": tuple(reasons)}


def overlay_with_points(scene_id: str, start_ns: int) -> Overlay:
    """Frames of a wall and two boxes of contradicting points, and one camera picture."""
    random = np.random.default_rng(7)
    boxes: list[list[float]] = []
    clouds, codes, owners, frames, tracks = [], [], [], [], []
    for frame in range(FRAMES):
        wall = np.stack([np.full(WALL, 25.0), *(random.uniform(-12, 12, (2, WALL)))])
        parts, outcome, owner = [wall.T], [np.zeros(WALL, np.uint8)], [np.full(WALL, -1)]
        for number in range(2):
            centre = np.array([12.0, 3.0 - 6.0 * number + 0.4 * frame, 0.0])
            parts.append(centre + random.uniform(-0.7, 0.7, (CAR, 3)))
            outcome.append(np.full(CAR, 2 - number, np.uint8))
            owner.append(np.full(CAR, len(boxes)))
            boxes.append([*centre, 4.2, 1.8, 1.4, 0.1])
            frames.append(frame)
            tracks.append(number)
        clouds.append(np.concatenate(parts))
        codes.append(np.concatenate(outcome))
        owners.append(np.concatenate(owner))
    points = FRAMES * (WALL + 2 * CAR)
    poses = np.repeat(np.eye(4)[None], FRAMES, axis=0)
    return Overlay(
        scene_id=scene_id,
        stamps_ns=start_ns + 100_000_000 * np.arange(FRAMES, dtype=np.int64),
        offsets=(WALL + 2 * CAR) * np.arange(FRAMES + 1, dtype=np.int64),
        points_cm=(100 * np.concatenate(clouds)).astype(np.int16),
        **labels_of_points(np.concatenate(codes)),
        ground_mask=np.zeros(points, np.bool_),
        class_id=np.full(points, -1, np.int16),
        class_names=NAMES,
        semantic_confidence=np.full(points, 255, np.uint8),
        predictive_confidence=np.full(points, 255, np.uint8),
        instance_index=np.concatenate(owners).astype(np.int32),
        odom_from_sensor=poses,
        instance_frame=np.array(frames, np.int32),
        instance_kind=np.array([2, 1] * FRAMES, np.uint8),
        instance_track=np.array(tracks, np.int32),
        instance_boxes=np.array(boxes, np.float32),
        pictures=(_picture(start_ns),),
    )


def _picture(start_ns: int) -> Picture:
    file = io.BytesIO()
    Image.new("RGB", (320, 200), (60, 90, 120)).save(file, "JPEG")
    camera_from_lidar = np.array(
        [[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], np.float64
    )
    return Picture(
        topic="/camera/front",
        frame=2,
        stamp_ns=start_ns,
        width=320,
        height=200,
        media_type="image/jpeg",
        image_bytes=file.getvalue(),
        pixel_from_camera=np.array([[200.0, 0, 160, 0], [0, 200, 100, 0], [0, 0, 1, 0]]),
        camera_from_lidar=camera_from_lidar,
        tracks=(0, 1),
    )


def state_with_points(folder: Path) -> None:
    """Make a state whose scenes can be shown."""
    for path in mined_state(folder, **two_tracks()):
        scene_id = decode_overlay(path.read_bytes()).scene_id
        start_ns = int(scene_id.rpartition("/")[2])
        path.write_bytes(encode_overlay(overlay_with_points(scene_id, start_ns)))


def overlay_path(state: Path, scene_id: str) -> Path:
    """The file of a scene's overlay."""
    place = StateReader(load_settings(state=state), now_s=0.0).overlay_place(scene_id)
    return Path(place.removeprefix("file://"))
