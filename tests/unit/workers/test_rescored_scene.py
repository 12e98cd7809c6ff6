"""A scene scored again from its stored overlay: the record and overlay that mining gives."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from schemas.canonical import sha256
from schemas.labels import MotionLabel
from schemas.overlay import overlay_key
from schemas.overlay_picture import Picture
from schemas.score import SceneScore
from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.overlay_codec import decode_overlay, encode_overlay
from schemas.transport.wire import encode_scene_score
from schemas.work import ManifestEntry
from tests.labelled_worlds import CLASS_NAMES, Thing, labelled_scene, shard_of
from tests.unit.service.test_picture import _Streams as Streams
from workers.contradiction import attribution, track_score
from workers.contradiction.attribution import attribute_tracks
from workers.contradiction.feature_extraction import extract_features
from workers.contradiction.instances import find_instances
from workers.contradiction.origin import Origin
from workers.contradiction.overlay import overlay_of
from workers.contradiction.scene_statistics import statistics_of
from workers.contradiction.score import score_scene
from workers.contradiction.scoring_inputs import encode_inputs, inputs_of
from workers.contradiction.track_score import rank_tracks
from workers.contradiction.tracks import associate_instances
from workers.rescore import NotRescoredError, rescore_scene

STATIC, DYNAMIC = MotionLabel.STATIC, MotionLabel.DYNAMIC
THINGS = [
    Thing((0, 15, 1), STATIC, STATIC, size_m=(40, 1.0, 4), points=900),
    Thing((-8, 6, 0), STATIC, DYNAMIC, velocity_m_per_s=(6, 0, 0), points=900),
    Thing((12, -6, 0), DYNAMIC, STATIC, class_id=2, size_m=(3, 2, 1.7), points=90),
]
PICTURE = Picture(
    topic="/camera",
    frame=1,
    stamp_ns=5,
    width=8,
    height=6,
    media_type="image/jpeg",
    image_bytes=b"not decoded here",
    pixel_from_camera=np.eye(3, 4),
    camera_from_lidar=np.eye(4),
    tracks=(0, 1),
)


def mine(
    version: str, *, pictures: tuple[Picture, ...] = (), log_id: str = ""
) -> tuple[SceneScore, bytes, bytes]:
    """Score, record and overlay as `mine_records` makes them; `log_id`: under another name."""
    scene, shard = labelled_scene(THINGS, frames=12), shard_of()
    if log_id:
        scene_id = f"{log_id}{scene.scene_id.removeprefix(shard.log_id)}"
        scene = replace(scene, scene_id=scene_id)
        shard = shard.model_copy(update={"log_id": log_id, "vehicle": "car-9"})
    instances = find_instances(scene, class_names=CLASS_NAMES)
    described = extract_features(scene, instances, associate_instances(scene, instances))
    ranked = rank_tracks(scene, described, attribute_tracks(described))
    score = score_scene(
        *(shard, scene, instances, ranked), parts=Streams(), pipeline_version=version
    )
    inputs = inputs_of(
        *(score, scene, instances, described, statistics_of(scene)), own_model=Streams.own_model
    )
    overlay = overlay_of(
        *(scene, instances, ranked),
        class_names=CLASS_NAMES,
        pictures=pictures,
        scoring_inputs=encode_inputs(inputs),
    )
    return score, encode_scene_score(score), encode_overlay(overlay)


def stored(folder: Path, overlay: bytes, score: SceneScore, record: bytes) -> tuple[Bucket, Any]:
    bucket = open_bucket(folder.as_uri())
    entry = ManifestEntry(scene_id=score.scene_id, sha256=sha256(record))
    bucket.put(key_of(score, entry), overlay)
    return bucket, entry


def key_of(score: SceneScore, entry: ManifestEntry) -> str:
    return overlay_key(
        log_id=score.log_id,
        scene_id=entry.scene_id,
        pipeline_version="before",
        sha256=entry.sha256,
    )


def again(bucket: Bucket, score: SceneScore, entry: ManifestEntry) -> Any:
    return rescore_scene(
        bucket, Origin.of(shard_of()), entry, before="before", pipeline_version="after"
    )


def test_the_same_program_gives_record_and_overlay_of_mining(tmp_path: Path) -> None:
    score, record, overlay = mine("before")
    _, mined_record, mined_overlay = mine("after")
    bucket, entry = stored(tmp_path, overlay, score, record)
    found = again(bucket, score, entry)
    assert found.record == mined_record
    assert found.overlay == mined_overlay
    assert found.sha256 == sha256(mined_record)
    assert found.overlay_key.startswith("overlays/after/")


def test_the_same_bytes_under_another_name_give_record_and_overlay_of_mining(
    tmp_path: Path,
) -> None:
    score, record, overlay = mine("before", pictures=(PICTURE,))
    other, mined_record, mined_overlay = mine("before", pictures=(PICTURE,), log_id="car-9/copy")
    bucket, entry = stored(tmp_path, overlay, score, record)
    shard = shard_of().model_copy(update={"log_id": "car-9/copy", "vehicle": "car-9"})
    found = rescore_scene(
        *(bucket, Origin.of(shard), entry),
        before="before",
        pipeline_version="before",
        before_log_id=score.log_id,
    )
    assert found.score == other
    assert found.record == mined_record
    assert found.overlay == mined_overlay
    assert found.overlay_key == key_of(
        other, ManifestEntry(scene_id=other.scene_id, sha256=sha256(mined_record))
    )


def test_a_changed_score_gives_record_and_overlay_of_mining(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tracks change their order, their attribution and their numbers in the overlay."""
    score, record, overlay = mine("before", pictures=(PICTURE,))
    bucket, entry = stored(tmp_path, overlay, score, record)
    swap_tables(monkeypatch)
    halve_strengths(monkeypatch)
    changed, mined_record, mined_overlay = mine("after")
    assert changed.score != score.score
    found = again(bucket, score, entry)
    assert found.record == mined_record
    rescored, mined = decode_overlay(found.overlay), decode_overlay(mined_overlay)
    assert rescored.instance_track.tolist() == mined.instance_track.tolist()
    assert encode_overlay(replace(rescored, pictures=())) == mined_overlay
    (kept,) = rescored.pictures
    assert kept.image_bytes == PICTURE.image_bytes
    before = decode_overlay(overlay)
    for number in PICTURE.tracks:
        members = before.instance_track == number
        assert set(rescored.instance_track[members]) <= set(kept.tracks)


def swap_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    before = attribution.tables()
    kinds = list(before)
    swapped = dict(zip(kinds, [before[kind] for kind in reversed(kinds)], strict=True))
    monkeypatch.setattr(attribution, "tables", lambda: swapped)


def halve_strengths(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = track_score._gate
    monkeypatch.setattr(track_score, "_gate", lambda *a, **k: 0.5 * gate(*a, **k))


def test_an_overlay_that_is_gone_or_damaged_or_without_inputs_is_named(tmp_path: Path) -> None:
    score, record, overlay = mine("before")
    bucket, entry = stored(tmp_path, overlay, score, record)
    without = replace(decode_overlay(overlay), scoring_inputs=b"")
    for payload, why in (
        (encode_overlay(without), "mine the log again"),
        (overlay[:-40], "damaged"),
        (b"nothing", "expected"),
    ):
        bucket.put(key_of(score, entry), payload)
        with pytest.raises(NotRescoredError, match=why):
            again(bucket, score, entry)
    bucket.delete(key_of(score, entry))
    with pytest.raises(NotRescoredError, match="the overlay is gone"):
        again(bucket, score, entry)


def test_the_overlay_of_another_version_is_refused(tmp_path: Path) -> None:
    score, record, _ = mine("before")
    _, _, other = mine("other")
    bucket, entry = stored(tmp_path, other, score, record)
    with pytest.raises(NotRescoredError, match="of another scene or version"):
        again(bucket, score, entry)
