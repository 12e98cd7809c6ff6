"""Overlays of stored scenes, read from the artifacts bucket."""

from schemas.errors import ObjectChangedError
from schemas.overlay import overlay_key
from schemas.transport.bucket import open_bucket
from schemas.transport.overlay_codec import MAX_OVERLAY_BYTES, overlay_file_of
from schemas.transport.overlay_file import OverlayFile, OverlayIsVersion1Error, open_overlay_file
from service.errors import NothingFoundError
from service.settings.hidden_passwords import shown
from service.store.ledger import StoredScene


def read_overlay(artifacts_url: str, scene: StoredScene) -> bytes:
    """Read the overlay of a scene from the artifacts bucket.

    Raises:
        NothingFoundError: If it does not exist.
        BucketRefusedError: If the object is no regular file, or is larger than any overlay.
    """
    try:
        return open_bucket(artifacts_url).read_all(key_of(scene), at_most=MAX_OVERLAY_BYTES)
    except ObjectChangedError:
        raise no_overlay(scene, artifacts_url) from None


def open_stored_overlay(artifacts_url: str, scene: StoredScene) -> OverlayFile:
    """Open the overlay of a scene in the artifacts bucket for reading single blocks.

    An overlay of version 1 has no blocks: it is read whole and encoded again.

    Raises:
        NothingFoundError: If it does not exist.
        PackUnreadableError: If it is damaged, or of a newer version; the message names its URL.
    """
    bucket, key = open_bucket(artifacts_url), key_of(scene)
    where = f"{shown(artifacts_url)}/{key}"
    found = bucket.head(key)
    if found is None:
        raise no_overlay(scene, artifacts_url)

    def read(offset: int, length: int) -> bytes:
        return bucket.read_range(key, offset, length, found.etag) if length else b""

    try:
        return open_overlay_file(read, file_bytes=found.size, where=where)
    except OverlayIsVersion1Error:
        return overlay_file_of(read_overlay(artifacts_url, scene), where=where)


def no_overlay(scene: StoredScene, artifacts_url: str) -> NothingFoundError:
    """Return the error for a scene without an overlay."""
    if scene.overlay_deleted:
        return NothingFoundError(
            f"the overlay of {scene.scene_id} was deleted, by artifacts_budget_bytes or "
            f"keep_withdrawn_days; `counterpoint retry {scene.log_id}` has it mined again"
        )
    return NothingFoundError(
        f"no overlay of {scene.scene_id} in {shown(artifacts_url)}; name its bucket with "
        "--artifacts"
    )


def key_of(scene: StoredScene) -> str:
    """Return the key of a scene's overlay in the artifacts bucket."""
    return overlay_key(
        log_id=scene.log_id,
        scene_id=scene.scene_id,
        pipeline_version=scene.pipeline_version,
        sha256=scene.sha256,
    )
