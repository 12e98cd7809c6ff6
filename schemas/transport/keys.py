"""Zenoh keys of the system. Segments are percent-encoded ASCII; no other module builds a key."""

from typing import Final
from urllib.parse import quote, unquote

from schemas.bounds import MAX_KEY_BYTES
from schemas.errors import PermanentError

DEFAULT_ROOT: Final = "counterpoint"

OWNER_END: Final = "~"
"""End of the certificate's name in the id of a worker; no name of a certificate has one."""


class KeyTooLongError(PermanentError):
    """No bus key can be made of names this long."""


def _part(text: str) -> str:
    return quote(text, safe="-_.~")


def score(*, root: str, worker_id: str) -> str:
    """Key to which a worker puts its raw scores, of any shard."""
    return f"{root}/v1/score/{_part(worker_id)}"


def all_scores(*, root: str) -> str:
    """Key expression that the service subscribes to."""
    return f"{root}/v1/score/**"


def scene(*, root: str, log_id: str, scene_id: str) -> str:
    """Key of one durable, numbered scene; one writer, the service.

    Raises:
        KeyTooLongError: If the names exceed the bounds of the current version.
    """
    return _whole(f"{root}/v1/scene/{_part(log_id)}/{_part(_within(log_id, scene_id))}")


def all_scenes(*, root: str) -> str:
    """Key expression of all scored scenes, for subscriptions and history requests."""
    return f"{root}/v1/scene/**"


def scene_cache(*, root: str) -> str:
    """Key from which a stock AdvancedSubscriber on `all_scenes` requests its history."""
    return f"{root}/v1/scene/**/@adv/**"


def all_selected(*, root: str) -> str:
    """Key expression of all selections, for subscriptions and for requests of existing ones."""
    return f"{root}/v1/selected/**"


def selected(*, root: str, selection: str, log_id: str, scene_id: str) -> str:
    """Key of one scene of a named selection.

    Raises:
        KeyTooLongError: If the names exceed the bounds of the current version.
    """
    parts = (selection, log_id, _within(log_id, scene_id))
    return _whole(f"{root}/v1/selected/{'/'.join(map(_part, parts))}")


def verdict(*, root: str, scene_id: str, ordinal: int) -> str:
    """Key of one numbered verdict; each has a key of its own, since each is an event.

    Raises:
        KeyTooLongError: If the names exceed the bounds of the current version.
    """
    log_id = scene_id.rsplit("/", 2)[0]
    return _whole(f"{root}/v1/verdict/{_part(log_id)}/{_part(_within(log_id, scene_id))}/{ordinal}")


def all_verdicts(*, root: str) -> str:
    """Key expression of all verdicts, for subscriptions and history requests."""
    return f"{root}/v1/verdict/**"


def control(*, root: str, verb: str) -> str:
    """Key of a question to the service."""
    return f"{root}/v1/ctl/{verb}"


def named_control(*, root: str, verb: str, name: str) -> str:
    """Key of a question that names who asks, which rules of access control bind to a certificate.

    Args:
        root: First part of every key.
        verb: The verb.
        name: Id of a worker, or name of a person or program.
    """
    return f"{root}/v1/ctl/{verb}/{_part(name)}"


def all_named_control(*, root: str, verb: str) -> str:
    """Key expression of a verb's questions that name who asks."""
    return f"{root}/v1/ctl/{verb}/*"


def name_of_asker(key: str) -> str:
    """Decode the name from a key that `named_control` made; empty if it names several."""
    part = key.rpartition("/")[2]
    return "" if "*" in part or "$" in part else unquote(part)


def owned_by(name: str) -> str:
    """Part of a key expression that matches the ids of the workers of one certificate."""
    return f"{_part(name)}{OWNER_END}$*"


def live(*, root: str, role: str, ident: str) -> str:
    """Key of a liveliness token."""
    return f"{root}/v1/live/{_part(role)}/{_part(ident)}"


def all_live(*, root: str, role: str) -> str:
    """Key expression of the liveliness tokens of every process in this role."""
    return f"{root}/v1/live/{_part(role)}/*"


def scene_id_of(key: str, *, root: str) -> str:
    """Decode the scene id from a key that `scene` made.

    Raises:
        ValueError: If the key is not one of a scene under this root.
    """
    prefix = f"{root}/v1/scene/"
    parts = key.removeprefix(prefix).split("/")
    if not key.startswith(prefix) or len(parts) != 2:
        raise ValueError(f"not the key of a scene under {root!r}: {key}")
    return f"{unquote(parts[0])}/{unquote(parts[1])}"


def _whole(key: str) -> str:
    if len(key) > MAX_KEY_BYTES:  # ASCII, so that its characters are its bytes
        raise KeyTooLongError(
            f"a key of {len(key)} bytes, of which the bus takes {MAX_KEY_BYTES}: {key[:80]}..."
        )
    return key


def _within(log_id: str, scene_id: str) -> str:
    return scene_id.removeprefix(f"{log_id}/")
