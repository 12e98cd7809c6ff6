"""Camera pictures that are kept with a scene: which ones, how large, and at what cost."""

from io import BytesIO
from zlib import crc32

import numpy as np
import pytest
from PIL import Image

from schemas.mining import MiningSettings
from schemas.overlay import Overlay
from schemas.score import SceneScore
from schemas.transport.bucket import Bucket
from schemas.work import Recording
from tests.labelled_worlds import Thing, labelled_scene, shard_of
from tests.unit.service.test_picture import DYNAMIC, PHANTOM, STATIC, WALL, mined_scene
from tests.unit.workers.test_camera import FORWARD, LIDAR, REAR, STAMP_NS, Log
from workers.ingest.camera import CameraReader
from workers.ingest.part_reader import MAX_RECENT_BYTES, RecentReads
from workers.ingest.read import read_shard
from workers.pictures.scene_pictures import ScenePictures, Size

FRAME_NS = 100_000_000
FRONT, REAR_TOPIC = "/front/image/compressed", "/rear/image/compressed"


@pytest.fixture(scope="module")
def mined() -> tuple[SceneScore, Overlay]:
    """A phantom ahead to the right, and a mover behind to the left, in view of the rear camera."""
    behind = Thing((-16, 4, 0), STATIC, DYNAMIC, velocity_m_per_s=(6, 0, 0), points=900)
    return mined_scene(labelled_scene([WALL, behind, PHANTOM], frames=12))


def _photo(width: int = 1280, height: int = 960, format_: str = "JPEG") -> bytes:
    out = BytesIO()
    Image.effect_noise((width, height), 40).convert("RGB").save(out, format=format_)
    return out.getvalue()


def _plain(width: int, height: int) -> bytes:
    out = BytesIO()
    Image.new("L", (width, height)).save(out, format="PNG")
    return out.getvalue()


def _bomb() -> bytes:
    """A PNG that claims 60,000 by 60,000 pixels."""
    head = b"IHDR" + (60_000).to_bytes(4, "big") * 2 + b"\x08\x02\0\0\0"
    return b"\x89PNG\r\n\x1a\n" + (13).to_bytes(4, "big") + head + crc32(head).to_bytes(4, "big")


def _log(
    *, damaged: frozenset[int] = frozenset(), photo: bytes | None = None, bad: bytes = b"\xff\xd8"
) -> Log:
    """Front and rear camera at 10 Hz; the front images of some frames are bad."""
    log, good = Log(), photo or _photo()
    log.transforms(("lidar", "front", (0.5, 0, 0), FORWARD), ("lidar", "rear", (-0.5, 0, 0), REAR))
    for frame in range(12):
        stamp_ns = STAMP_NS + frame * FRAME_NS
        log.cloud(stamp_ns)
        for camera in ("front", "rear"):
            is_damaged = camera == "front" and frame in damaged
            log.image(camera, stamp_ns + 3_000_000, data=bad if is_damaged else good)
            log.info(camera, stamp_ns)
    return log


def _pictures(size: Size, log: Log, *, has_cameras: bool = True) -> ScenePictures:
    bucket, recording = log.recording()
    return _of(bucket, recording, size, has_cameras=has_cameras)


def _of(bucket: Bucket, recording: Recording, size: Size, *, has_cameras: bool) -> ScenePictures:
    shard = shard_of()
    lidar = shard.lidar.model_copy(update={"topic": LIDAR})
    shard = shard.model_copy(update={"lidar": lidar, "has_cameras": has_cameras})
    settings = MiningSettings(bucket="memory://", artifacts="")
    return ScenePictures.of(bucket, read_shard(bucket, recording, shard, settings), size=size)


def test_the_images_in_which_tracks_are_strongest_are_kept_small(
    mined: tuple[SceneScore, Overlay],
) -> None:
    score, overlay = mined
    pictures = _pictures("small", _log())
    kept = pictures.of_scene(score, overlay)
    strongest = {
        int(np.searchsorted(overlay.stamps_ns, track.strongest.stamp_ns)) for track in score.tracks
    }
    assert {picture.frame for picture in kept} <= strongest
    assert {picture.topic for picture in kept} == {FRONT, REAR_TOPIC}
    assert {track for picture in kept for track in picture.tracks} == {0, 1}
    for picture in kept:
        assert (picture.width, picture.height, picture.media_type) == (640, 480, "image/jpeg")
        assert Image.open(BytesIO(picture.image_bytes)).size == (640, 480)
        assert picture.stamp_ns == overlay.stamps_ns[picture.frame] + 3_000_000
        assert len(picture.tracks) == 1
    assert pictures.pictures == len(kept)
    assert pictures.picture_bytes == sum(len(picture.image_bytes) for picture in kept)


def test_a_kept_picture_has_the_projection_of_its_own_size(
    mined: tuple[SceneScore, Overlay],
) -> None:
    kept = _pictures("small", _log()).of_scene(*mined)
    front = next(picture for picture in kept if picture.topic == FRONT)
    ahead = front.camera_from_lidar @ (10.5, 2.0, 0.0, 1.0)
    u, v, w = front.pixel_from_camera @ ahead
    np.testing.assert_allclose((u / w, v / w), (220, 240), atol=1e-9)  # ten times 22, 24


def test_all_keeps_every_image_that_sees_a_track_as_it_was_recorded(
    mined: tuple[SceneScore, Overlay],
) -> None:
    photo = _photo(format_="PNG")
    kept = _pictures("all", _log(photo=photo)).of_scene(*mined)
    assert [picture.frame for picture in kept if picture.topic == FRONT] == list(range(12))
    assert all(picture.image_bytes == photo for picture in kept)
    assert {picture.media_type for picture in kept} == {"image/png"}
    assert {(picture.width, picture.height) for picture in kept} == {(1280, 960)}


@pytest.mark.parametrize(
    "bad",
    [
        pytest.param(_photo()[:2000], id="truncated JPEG"),
        pytest.param(_photo(format_="PNG")[:2000], id="truncated PNG"),
        pytest.param(b"no image", id="no image"),
        pytest.param(_bomb(), id="far too many pixels"),
        pytest.param(_plain(9000, 9000), id="too many pixels"),
    ],
)
def test_a_damaged_image_costs_that_picture_only(
    mined: tuple[SceneScore, Overlay], bad: bytes
) -> None:
    whole = _pictures("small", _log()).of_scene(*mined)
    lost = next(picture for picture in whole if picture.topic == FRONT)
    kept = _pictures("small", _log(damaged=frozenset({lost.frame}), bad=bad)).of_scene(*mined)
    assert {(p.topic, p.frame) for p in whole} - {(p.topic, p.frame) for p in kept} == {
        (lost.topic, lost.frame)
    }


@pytest.mark.parametrize(("size", "has_cameras"), [("none", True), ("small", False)])
def test_nothing_is_read_where_no_picture_is_wanted_or_there(
    mined: tuple[SceneScore, Overlay], size: Size, has_cameras: bool
) -> None:
    bucket, recording = _log().recording()
    before = bucket.reads
    pictures = _of(bucket, recording, size, has_cameras=has_cameras)
    assert pictures.of_scene(*mined) == ()
    assert (bucket.reads, pictures.range_reads) == (before, 0)


def test_nothing_is_read_for_a_scene_without_tracks(mined: tuple[SceneScore, Overlay]) -> None:
    score, overlay = mined
    pictures = _pictures("small", _log())
    assert pictures.of_scene(score.model_copy(update={"tracks": ()}), overlay) == ()
    assert pictures.range_reads == 0


def test_a_log_whose_cameras_have_no_place_is_searched_a_few_times_only(
    mined: tuple[SceneScore, Overlay], monkeypatch: pytest.MonkeyPatch
) -> None:
    log = Log()
    for frame in range(12):
        log.cloud(STAMP_NS + frame * FRAME_NS)
        log.image("front", STAMP_NS + frame * FRAME_NS)
    pictures = _pictures("small", log)
    asked: list[int] = []
    views_at = CameraReader.views_at

    def counted(reader: CameraReader, stamp_ns: int) -> object:
        asked.append(stamp_ns)
        return views_at(reader, stamp_ns)

    monkeypatch.setattr(CameraReader, "views_at", counted)
    for _ in range(10):
        assert pictures.of_scene(*mined) == ()
    assert len(asked) <= 9


def test_what_the_reader_of_the_clouds_has_read_is_not_read_again(
    mined: tuple[SceneScore, Overlay],
) -> None:
    pictures = _pictures("small", _log())
    assert pictures.cameras is not None
    (recent,) = pictures.cameras.recent
    data = pictures.cameras.bucket.read_all("log.mcap")
    recent.add(0, memoryview(data))
    assert len(pictures.of_scene(*mined)) > 1
    assert pictures.bytes_read == 0


def test_recent_reads_are_bounded_and_the_newest_stay() -> None:
    recent, size = RecentReads(), MAX_RECENT_BYTES // 4
    data = memoryview(bytes(size))
    for number in range(6):
        recent.add(number * size, data)
    assert [recent.find(number * size, 10) is not None for number in range(6)] == [
        *(False, False, True, True, True, True)
    ]
    assert recent.find(3 * size - 1, 2) is None, "two reads are not joined"
    recent.add(0, memoryview(bytes(MAX_RECENT_BYTES + 1)))
    assert recent.find(5 * size, 10) is None
    assert recent.find(0, 10) is None, "larger than all that may be kept"
