"""Identity of a log: vehicle, date and software version, from its metadata or else its path."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from schemas.bounds import MAX_NAME
from schemas.visible import visible
from workers.errors import LogUnusableError

UNKNOWN: Final = "unknown"
METADATA_RECORD: Final = "counterpoint.log"
_FIELDS: Final = ("vehicle", "date", "software_version")
_PLACEHOLDER: Final = re.compile(r"\{(\w+)\}")


@dataclass(frozen=True, slots=True)
class Identity:
    """Vehicle, date and software version, as in every scene score of a log.

    Attributes:
        vehicle: Name of the car.
        date: Unchanged text of the log.
        software_version: Unchanged text of the log.
        remarks: A sentence for each of them that was escaped or cut.
    """

    vehicle: str = UNKNOWN
    date: str = UNKNOWN
    software_version: str = UNKNOWN
    remarks: tuple[str, ...] = ()


def identify(log_id: str, metadata: Iterable[Mapping[str, str]], *, path_template: str) -> Identity:
    """Find the vehicle, date and software version of a log.

    Args:
        log_id: Key of the recording without extension and split number.
        metadata: The `counterpoint.log` records of all its parts, in their order.
        path_template: Like `{vehicle}/{date}/{name}`, matched from the right of the log id.

    Raises:
        LogUnusableError: If the parts name different vehicles, or the template is invalid.
    """
    records = list(metadata)
    vehicles = sorted({name for each in records if (name := each.get("vehicle", "").strip())})
    if len(vehicles) > 1:
        raise LogUnusableError(
            f"the parts of the recording name different vehicles: {', '.join(vehicles)} ({log_id})"
        )
    from_path = match_path(log_id, path_template)
    found: dict[str, str] = {}
    remarks: list[str] = []
    for field in _FIELDS:
        recorded = [value for each in records if (value := each.get(field, "").strip())]
        text = recorded[0] if recorded else from_path.get(field, UNKNOWN)
        found[field] = visible(text, limit=MAX_NAME)
        if found[field] != text:
            remarks.append(
                f"the {field.replace('_', ' ')} has {len(text)} characters, of which at most "
                f"{MAX_NAME} are kept, and control characters only escaped"
            )
    return Identity(**found, remarks=tuple(remarks))


def match_path(log_id: str, path_template: str) -> dict[str, str]:
    """Match the placeholders of a template from the right end of a log id.

    Returns:
        Placeholder to text; empty where the log id does not fit.

    Raises:
        LogUnusableError: If the template names a placeholder twice.
    """
    literals = _PLACEHOLDER.split(path_template)
    names = literals[1::2]
    if len(set(names)) != len(names):
        raise LogUnusableError(f"path template names a placeholder twice: {path_template!r}")
    pattern = "".join(
        f"(?P<{part}>[^/]+)" if number % 2 else re.escape(part)
        for number, part in enumerate(literals)
    )
    match = re.search(f"(?:^|/){pattern}$", log_id)
    return match.groupdict() if match else {}
