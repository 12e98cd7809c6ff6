from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest

from schemas.labels import Agreement
from schemas.overlay import NO_POSITION_CM, Overlay, OverlayLidar, overlay_key
from schemas.overlay_picture import Picture
from schemas.task import GROUND
from schemas.transport.array_pack import MAX_UNPACKED_BYTES, PackUnreadableError, pack, unpack
from schemas.transport.bucket import open_bucket
from schemas.transport.overlay_codec import decode_overlay, encode_overlay
from schemas.transport.overlay_version_1 import VERSION_1_MAGIC
from tests.overlays import labels_of_points
from workers.lab.evaluation.benchmarks.bench_overlay import encode_version_1

ARRAYS = (
    "stamps_ns",
    "offsets",
    "points_cm",
    "semantic_labels",
    "predictive_labels",
    "witness_labels",
    "agreements",
    "ground_mask",
    "class_id",
    "semantic_confidence",
    "predictive_confidence",
    "instance_index",
    "odom_from_sensor",
    "instance_frame",
    "instance_kind",
    "instance_track",
    "instance_boxes",
)


def _overlay(*, points: int = 700, instances: int = 2, frames: int = 2) -> Overlay:
    rng = np.random.default_rng(5)
    total = frames * points
    index = np.full(total, -1, dtype=np.int32)
    if instances:
        index[: total // 4] = rng.integers(0, instances, total // 4)
    return Overlay(
        scene_id="fleet/car-1/drive/lidar/1700000000000000000",
        stamps_ns=1_700_000_000_000_000_000 + np.arange(frames, dtype=np.int64) * 100_000_000,
        offsets=np.arange(frames + 1, dtype=np.int64) * points,
        points_cm=rng.integers(-32768, 32768, (total, 3)).astype(np.int16),
        semantic_labels=rng.integers(0, 3, total).astype(np.uint8),
        predictive_labels=rng.integers(0, 3, total).astype(np.uint8),
        witness_labels=rng.integers(0, 3, total).astype(np.uint8),
        ground_mask=rng.random(total) < 0.5,
        class_id=rng.integers(-1, 2, total).astype(np.int16),
        class_names=("building", "Fußgänger"),
        semantic_confidence=rng.integers(0, 256, total).astype(np.uint8),
        predictive_confidence=rng.integers(0, 256, total).astype(np.uint8),
        instance_index=index,
        odom_from_sensor=rng.random((frames, 4, 4)),
        instance_frame=np.zeros(instances, dtype=np.int32),
        instance_kind=np.full(instances, Agreement.ONLY_PREDICTIVE_DYNAMIC, dtype=np.uint8),
        instance_track=np.arange(instances, dtype=np.int32),
        instance_boxes=rng.random((instances, 7)).astype(np.float32),
        pictures=(_picture(),) if instances else (),
        scoring_inputs=b"{}" * instances,
    )


def _picture() -> Picture:
    rng = np.random.default_rng(6)
    return Picture(
        topic="/camera/front",
        frame=0,
        stamp_ns=1_700_000_000_000_000_007,
        width=64,
        height=48,
        media_type="image/jpeg",
        image_bytes=b"\xff\xd8 and so on",
        pixel_from_camera=rng.random((3, 4)),
        camera_from_lidar=rng.random((4, 4)),
        distortion_model="plumb_bob",
        distortion=(0.1, 1e-17, 0.0),
        tracks=(0, 3),
    )


@pytest.mark.parametrize(
    ("points", "instances", "frames"),
    [
        pytest.param(700, 2, 2, id="a scene"),
        pytest.param(333, 0, 1, id="nothing contradicts"),
        pytest.param(0, 0, 3, id="frames without a point"),
    ],
)
def test_what_is_decoded_is_what_was_encoded(points: int, instances: int, frames: int) -> None:
    before = _overlay(points=points, instances=instances, frames=frames)
    after = decode_overlay(encode_overlay(before))
    assert after.scene_id == before.scene_id
    assert after.class_names == before.class_names
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name), err_msg=name)
        assert getattr(after, name).dtype == getattr(before, name).dtype, name
    assert after.scoring_inputs == before.scoring_inputs
    for mine, theirs in zip(after.pictures, before.pictures, strict=True):
        for each in Picture.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(mine, each), getattr(theirs, each), err_msg=each)


@pytest.mark.parametrize("points", [0, 333])
def test_an_overlay_of_version_1_opens_with_the_labels_that_it_had(points: int) -> None:
    before = _overlay(points=points)
    after = decode_overlay(encode_version_1(before))
    compared = before.agreements != Agreement.NOT_COMPARED
    for name in ARRAYS:
        told, known = getattr(after, name), getattr(before, name)
        if name in {"semantic_labels", "predictive_labels"}:
            known = np.where(compared, known, np.uint8(2))
        if name == "witness_labels":
            known = np.full(2 * points, 2, dtype=np.uint8)
        np.testing.assert_array_equal(told, known, err_msg=name)
    assert after.pictures == ()
    assert after.scoring_inputs == b""


def test_further_lidars_are_kept_and_one_lidar_takes_no_byte() -> None:
    alone = _overlay()
    lidar = OverlayLidar(
        topic="/front/points",
        points=np.array([3, 0]),
        stamps_ns=np.array([1_700_000_000_123_456_789, 0]),
        main_from_lidar=np.stack([np.eye(4), 2.0 * np.eye(4)]),
    )
    joined = replace(alone, lidars=(lidar,))
    (decoded,) = decode_overlay(encode_overlay(joined)).lidars
    assert decoded.topic == lidar.topic
    for name in ("points", "stamps_ns", "main_from_lidar"):
        np.testing.assert_array_equal(getattr(decoded, name), getattr(lidar, name))
    assert joined.main_points.tolist() == [alone.main_points[0] - 3, alone.main_points[1]]
    assert b'"lidars"' not in encode_overlay(alone)


def test_a_lidar_with_more_points_than_the_frame_is_refused() -> None:
    alone = _overlay(points=700)
    lidar = OverlayLidar("/front", np.array([701, 0]), np.zeros(2, int), np.stack([np.eye(4)] * 2))
    with pytest.raises(ValueError, match="points of the main lidar"):
        replace(alone, lidars=(lidar,))


def test_another_task_keeps_its_labels() -> None:
    before = replace(_overlay(), task=GROUND)
    after = decode_overlay(encode_overlay(before))
    assert after.task is GROUND
    np.testing.assert_array_equal(after.agreements, before.agreements)


def test_equal_overlays_are_equal_bytes() -> None:
    assert encode_overlay(_overlay()) == encode_overlay(_overlay())


def test_neighbouring_points_take_few_bytes() -> None:
    turn = np.linspace(0, 2 * np.pi, 20_000)
    wall_cm = np.stack([2000 * np.cos(turn), 2000 * np.sin(turn), 0 * turn], axis=1)
    overlay = replace(
        _overlay(points=20_000, instances=0, frames=1),
        points_cm=np.rint(wall_cm).astype(np.int16),
        **labels_of_points(np.zeros(20_000, dtype=np.uint8)),
        ground_mask=np.zeros(20_000, dtype=np.bool_),
        class_id=np.zeros(20_000, dtype=np.int16),
        semantic_confidence=np.full(20_000, 240, dtype=np.uint8),
        predictive_confidence=np.full(20_000, 240, dtype=np.uint8),
    )
    assert len(encode_overlay(overlay)) < 20_000


def test_points_of_a_frame_are_in_metres_and_know_who_has_no_position() -> None:
    points_cm = np.array([[100, -250, 3], [NO_POSITION_CM] * 3, [0, 0, 0]], dtype=np.int16)
    overlay = replace(
        _overlay(points=1, instances=0, frames=3), points_cm=points_cm, stamps_ns=np.arange(3)
    )
    np.testing.assert_allclose(overlay.points_m(0), [[1.0, -2.5, 0.03]], atol=1e-6)
    assert [overlay.has_position(f).tolist() for f in range(3)] == [[True], [False], [True]]


def test_no_reader_can_change_an_overlay() -> None:
    overlay = decode_overlay(encode_overlay(_overlay()))
    with pytest.raises(ValueError, match="read-only"):
        overlay.agreements[0] = 1


@pytest.mark.parametrize("cut", [0, 3, 8, 20, 200, -1])
def test_a_truncated_overlay_is_refused(cut: int) -> None:
    with pytest.raises(PackUnreadableError):
        decode_overlay(encode_overlay(_overlay())[:cut])


def test_a_flipped_byte_is_noticed() -> None:
    payload = bytearray(encode_overlay(_overlay()))
    for at in range(16, len(payload), 997):
        damaged = bytearray(payload)
        damaged[at] ^= 0x40
        with pytest.raises(PackUnreadableError, match="damaged"):
            decode_overlay(bytes(damaged))


def test_an_overlay_of_a_newer_version_is_refused_with_a_sentence() -> None:
    newer = b"CPOVL3\n\0" + encode_overlay(_overlay())[8:]
    with pytest.raises(PackUnreadableError, match=r"^the overlay is of version 3, .* update"):
        decode_overlay(newer)


def test_something_else_is_refused_by_its_first_bytes() -> None:
    with pytest.raises(PackUnreadableError, match="expected b'CPOVL2"):
        decode_overlay(b"\x89PNG\r\n\x1a\n and so on")


def test_a_bomb_is_refused_before_it_is_decompressed() -> None:
    claims_eight_gib = b"\x28\xb5\x2f\xfd\xe0" + (8 * 2**30).to_bytes(8, "little") + b"\x01\0\0"
    with pytest.raises(PackUnreadableError, match="more than"):
        decode_overlay(VERSION_1_MAGIC + claims_eight_gib)
    assert MAX_UNPACKED_BYTES < 8 * 2**30


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"semantic_labels": np.full(1400, 9, np.uint8)}, "semantic_labels must lie in 0 to 2"),
        ({"witness_labels": np.full(1400, 3, np.uint8)}, "witness_labels must lie in 0 to 2"),
        ({"instance_kind": np.full(2, 4, np.uint8)}, "instance_kind must lie in 0 to 3"),
        ({"pictures": (replace(_picture(), frame=2),)}, "frames of pictures must lie in 0 to 1"),
        ({"class_id": np.full(1400, 7, dtype=np.int16)}, "class_id must lie in -1 to 1"),
        ({"instance_index": np.full(1400, 2, dtype=np.int32)}, "instance_index must lie in"),
        ({"offsets": np.array([0, 900, 1300])}, "offsets must run from 0 to 1400"),
        ({"offsets": np.array([0, 1500, 1400])}, "offsets must lie in"),
        ({"predictive_labels": np.zeros(3, np.uint8)}, r"labels must be \(1400\) uint8"),
        ({"points_cm": np.zeros((1400, 2), dtype=np.int16)}, "points_cm must be"),
    ],
)
def test_arrays_that_do_not_fit_each_other_are_refused(
    change: dict[str, object], says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        replace(_overlay(), **change)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"media_type": "image/webp"}, "not 'image/webp'"),
        ({"width": 0}, "not 0 x 48"),
        ({"topic": "t" * 257}, "topic or the lens model"),
        ({"distortion": (0.0,) * 65}, "at most 64 coefficients"),
        ({"distortion": (float("nan"),)}, "not finite"),
        ({"camera_from_lidar": np.full((4, 4), np.inf)}, "not finite"),
        ({"pixel_from_camera": np.zeros((3, 3))}, "pixel_from_camera must be"),
    ],
)
def test_a_picture_that_no_reader_would_take_is_refused(
    change: dict[str, object], says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        replace(_picture(), **change)  # type: ignore[arg-type]


def test_a_pack_with_a_lying_header_is_refused() -> None:
    for arrays in ({"points_cm": np.zeros((3, 5), dtype=np.uint8)}, {}):
        payload = pack(VERSION_1_MAGIC, {"scene_id": "s", "class_names": []}, arrays)
        with pytest.raises(PackUnreadableError, match="not a well-formed overlay"):
            decode_overlay(payload)


def test_a_pack_gives_back_arrays_of_every_kind() -> None:
    arrays = {
        "a": np.arange(6, dtype=np.int32).reshape(2, 3),
        "b": np.array(True),
        "c": np.zeros((0, 7), dtype=np.float64),
    }
    meta, back = unpack(b"M", pack(b"M", {"k": [1, "ü"]}, arrays))
    assert meta == {"k": [1, "ü"]}
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)


def test_a_pack_refuses_what_it_could_not_read_back() -> None:
    with pytest.raises(ValueError, match="cannot pack arrays of these types"):
        pack(b"M", {}, {"words": np.array(["a"])})


def test_the_key_names_log_version_and_scene_and_stays_a_plain_path() -> None:
    key = overlay_key(
        log_id="münchen/car 7/../drive",
        scene_id="münchen/car 7/../drive/lidar.top/1700000000000000000",
        pipeline_version="abcdef012345",
        sha256="0123456789abcdef" * 4,
    )
    assert key == (
        "overlays/abcdef012345/m%C3%BCnchen/car%207/%2E%2E/drive/@/"
        "lidar.top/1700000000000000000-0123456789abcdef.overlay"
    )


def test_no_two_scenes_share_a_key() -> None:
    named = [("a", "a/b/1"), ("a/b", "a/b/b/1"), ("a/@", "a/@/b/1"), ("a", "a/b/2")]
    keys = {
        overlay_key(log_id=log, scene_id=s, pipeline_version="v", sha256="0" * 64)
        for log, s in named
    }
    assert len(keys) == len(named)


def test_what_a_replaced_log_shows_does_not_overwrite_what_may_return() -> None:
    """The scenes of old bytes come back without being mined, and need their own points then."""
    before, after = (
        overlay_key(log_id="a", scene_id="a/b/1", pipeline_version="v", sha256=digest * 64)
        for digest in "12"
    )
    assert before != after


CAR = "车" * 80


@pytest.mark.parametrize(
    ("log_id", "lidar"),
    [
        pytest.param(f"car/{CAR}", "lidar", id="file name of 80 Chinese characters"),
        pytest.param("x" * 255, "lidar", id="longest file name"),
        pytest.param("car/drive", "t" * 256, id="long topic"),
        pytest.param("car/drive", "雷" * 256, id="long Chinese topic"),
        pytest.param("/".join([CAR[:40]] * 20), "lidar", id="deep folders"),
    ],
)
def test_a_long_name_makes_a_key_that_any_store_takes(
    log_id: str, lidar: str, tmp_path: Path
) -> None:
    keys = [
        overlay_key(
            log_id=f"{log_id}{other}",
            scene_id=f"{log_id}{other}/{lidar}{more}/1700000000000000000-2",
            pipeline_version="abcdef012345",
            sha256="0123456789abcdef" * 4,
        )
        for other in ("", "a", "b")
        for more in ("", "a", "b")
    ]
    assert len(set(keys)) == len(keys)
    bucket = open_bucket(str(tmp_path))
    for key in keys:
        assert len(key) <= 1024
        bucket.put(key, key.encode())
    assert [bucket.read_all(found.key).decode() for found in bucket.list()] == sorted(keys)


def test_a_cut_name_is_none_that_another_log_may_have() -> None:
    long = overlay_key(log_id=CAR, scene_id=f"{CAR}/l/1", pipeline_version="v", sha256="0" * 64)
    cut = unquote(long.split("/")[2])
    assert "@" in cut
    assert (
        overlay_key(log_id=cut, scene_id=f"{cut}/l/1", pipeline_version="v", sha256="0" * 64)
        != long
    )


@pytest.mark.parametrize("length", [1, 100, 254, 255])
def test_a_key_of_ordinary_length_is_what_it_always_was(length: int) -> None:
    """Else an existing state would not find its overlays."""
    name = "n" * length
    key = overlay_key(
        log_id=f"car/{name}",
        scene_id=f"car/{name}/lidar.top/1700000000000000000",
        pipeline_version="v",
        sha256="0123456789abcdef" * 4,
    )
    scene = "lidar.top/1700000000000000000-0123456789abcdef.overlay"
    assert key == f"overlays/v/car/{name}/@/{scene}"
