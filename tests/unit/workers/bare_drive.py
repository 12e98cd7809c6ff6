"""A simulated log of two scenes without recorded answers, its truth, and the drive of it."""

from pathlib import Path
from typing import Final

from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.overlay_codec import encode_overlay
from schemas.transport.wire import encode_scene_score
from tests.factories import street_log
from workers.contradiction.overlay import overlay_of
from workers.lab.evaluation.failures.bench import jobs_of
from workers.lab.evaluation.failures.planting.drive import Drive, FrameRange
from workers.lab.evaluation.failures.planting.load_drive import load_drive
from workers.lab.evaluation.truth.truth import LogTruth
from workers.lab.simulation.sensor.lidar import UNEVEN_64, Lidar
from workers.parts.protocols import Parts
from workers.pipeline import MinedScene

FRAMES: Final = 40
KEY: Final = "car-7/2026-03-02/drive"
LIDAR: Final = Lidar(elevation_deg=UNEVEN_64[::2], columns=256)
IDENTITY: Final = {"vehicle": "sim-01", "date": "2026-03-02", "software_version": "2026.1"}


def write_bare_log(fleet: Path) -> None:
    """Write the log to `logs` and its truth to `truth` of a folder."""
    street_log(
        fleet / "logs" / f"{KEY}.mcap",
        frames=FRAMES,
        seed=4,
        lidar=LIDAR,
        recorded_as="nothing",
        truth=fleet / "truth" / KEY,
    )


def settings_of(fleet: Path) -> MiningSettings:
    return MiningSettings(bucket=str(fleet / "logs"), artifacts="memory://", supervised="recorded")


def drive_of(fleet: Path, parts: Parts) -> Drive:
    bucket = open_bucket(str(fleet / "logs"))
    recording = jobs_of(str(fleet / "logs"), fleet / "truth")[0].recording
    truth = LogTruth.beside(recording, fleet / "truth")
    assert truth is not None
    return load_drive(bucket, recording, truth, settings_of(fleet), parts, frames=FrameRange())


def bytes_of(mined: MinedScene, parts: Parts) -> tuple[bytes, bytes]:
    """Return the record and the overlay of a scene, as they are stored."""
    names = parts.supervised.class_names
    overlay = overlay_of(mined.scene, mined.instances, mined.tracks, class_names=names)
    return encode_scene_score(mined.score), encode_overlay(overlay)
