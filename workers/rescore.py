"""Rescoring of one scene: its record and overlay under another version, from its stored overlay."""

from dataclasses import replace

from schemas.canonical import sha256
from schemas.errors import BucketRefusedError, ObjectChangedError, PermanentError
from schemas.overlay import overlay_key
from schemas.transport.array_pack import PackUnreadableError
from schemas.transport.bucket import Bucket
from schemas.transport.overlay_codec import MAX_OVERLAY_BYTES, overlay_file_of
from schemas.transport.overlay_file import OverlayFile
from schemas.transport.overlay_rescored import encode_rescored
from schemas.transport.wire import encode_scene_score
from schemas.work import ManifestEntry
from workers.contradiction.origin import Origin
from workers.contradiction.overlay import tracks_of
from workers.contradiction.rescoring import rescored_tracks
from workers.contradiction.scoring_inputs import (
    ScoringInputsUnreadableError,
    decode_inputs,
    encode_inputs,
)
from workers.mine import MinedRecord


class NotRescoredError(PermanentError):
    """The scene cannot be scored from its overlay: its log has to be mined."""


def rescore_scene(
    artifacts: Bucket,
    origin: Origin,
    entry: ManifestEntry,
    *,
    before: str,
    pipeline_version: str,
    before_log_id: str = "",
) -> MinedRecord:
    """Score a scene again from its overlay, as mining would: the same record, byte for byte.

    Args:
        artifacts: Bucket of the overlays.
        origin: Log, lidar and vehicle of the new record.
        entry: The scene, and the digest of its record before.
        before: Pipeline version that mined it.
        pipeline_version: Version of the new record.
        before_log_id: Log of the same bytes whose scene it was; empty: the log of `origin`.

    Raises:
        NotRescoredError: If the overlay is gone, damaged, or without inputs of the score.
        BucketUnreachableError: If the artifacts do not answer.
        BucketRefusedError: If they refuse.
    """
    mined_as = before_log_id or origin.log_id
    key = overlay_key(
        log_id=mined_as, scene_id=entry.scene_id, pipeline_version=before, sha256=entry.sha256
    )
    file = _opened(artifacts, key)
    try:
        inputs = decode_inputs(file.scoring_inputs())
    except (ScoringInputsUnreadableError, PackUnreadableError) as error:
        raise NotRescoredError(f"{error} ({key})") from error
    if inputs.scene.scene_id != entry.scene_id or inputs.producers.pipeline_version != before:
        raise NotRescoredError(
            f"the overlay is of another scene or version than {entry.scene_id} of {before} ({key})"
        )
    producers = inputs.producers.model_copy(update={"pipeline_version": pipeline_version})
    scene_id = f"{origin.log_id}{entry.scene_id.removeprefix(mined_as)}"
    if before_log_id:
        inputs = replace(inputs, origin=origin, scene=replace(inputs.scene, scene_id=scene_id))
    inputs = replace(inputs, producers=producers)
    score, ranked = rescored_tracks(inputs)
    try:
        overlay = encode_rescored(
            file,
            scene_id=scene_id,
            instance_track=tracks_of(len(inputs.instances), ranked).tolist(),
            scoring_inputs=encode_inputs(inputs),
        )
    except (PackUnreadableError, ValueError) as error:
        raise NotRescoredError(f"{error} ({key})") from error
    record = encode_scene_score(score)
    digest = sha256(record)
    return MinedRecord(
        score=score,
        record=record,
        sha256=digest,
        overlay=overlay,
        overlay_key=overlay_key(
            log_id=origin.log_id,
            scene_id=score.scene_id,
            pipeline_version=pipeline_version,
            sha256=digest,
        ),
    )


def _opened(artifacts: Bucket, key: str) -> OverlayFile:
    where = f"{artifacts.url}, {key}"
    try:
        payload = artifacts.read_all(key, at_most=MAX_OVERLAY_BYTES)
    except ObjectChangedError as error:
        raise NotRescoredError(f"the overlay is gone ({where})") from error
    except BucketRefusedError as error:
        raise NotRescoredError(str(error)) from error
    try:
        return overlay_file_of(payload, where=where)
    except PackUnreadableError as error:
        raise NotRescoredError(str(error)) from error
