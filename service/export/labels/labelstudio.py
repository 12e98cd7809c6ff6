"""Answers of `labelstudio`: which stream is wrong on each track that was asked about, as verdicts.

The file is the one that Label Studio exports as `JSON`. A task keeps its data, and so the scene,
the digest of its record and its tracks; a choice is the name of a verdict. There are no labels of
points.
"""

from pathlib import Path
from typing import Any, Final

from schemas.bounds import MAX_NAME
from schemas.verdict import GIVEN, Verdict
from service.curation.verdicts import JudgeRequest, key_of_content
from service.export.labels.label_file import read_json, unlike
from service.export.labelstudio import CHOICE, TRACKS

NAME: Final = "labelstudio"
"""Name of this form for `import-labels --format`."""

NOTE: Final = "from Label Studio"
"""Note of these verdicts."""

MAX_TASKS: Final = 100_000
"""Tasks of one file at most."""

_WHAT: Final = "export of Label Studio as JSON"


def read_answers(path: Path, reviewer: str) -> list[JudgeRequest]:
    """Read the answers of all tasks; an annotation that was cancelled has none.

    Args:
        path: The file.
        reviewer: Name under which they are stored, followed by that of the annotator.

    Returns:
        A request for each answer; its key follows from the content, so that a repeated import
        stores nothing.

    Raises:
        UsageError: If the file is none of Label Studio, if its tasks are of no export, or if a
            choice is no verdict.
    """
    read = read_json(path, what=_WHAT)
    if not isinstance(read, list) or len(read) > MAX_TASKS:
        raise unlike(_WHAT, "it is no list of tasks", path)
    try:
        return [
            request
            for task in read
            for annotation in task["annotations"]
            if not annotation.get("was_cancelled")
            for request in _answers(task["data"], annotation, reviewer)
        ]
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        # pydantic's errors have many lines; the first one names the fault
        why = f"{type(error).__name__}: {str(error).splitlines()[0]}"
        raise unlike(_WHAT, why, path) from None


def _answers(data: dict[str, Any], annotation: dict[str, Any], reviewer: str) -> list[JudgeRequest]:
    name = f"{reviewer}-{_annotator(annotation.get('completed_by'))}"[:MAX_NAME]
    made: list[JudgeRequest] = []
    for result in annotation["result"]:
        place = str(result["from_name"]).removeprefix(CHOICE)
        if result["type"] != "choices" or not place.isdecimal():
            continue
        track_id, digest = int(data[TRACKS][int(place)]), str(data["record_sha256"])
        (choice,) = result["value"]["choices"]
        if choice not in GIVEN:
            raise ValueError(f"the choice {choice!r} is no verdict")
        made.append(
            JudgeRequest(
                key=key_of_content(name, digest, str(track_id), choice),
                scene_id=data["scene_id"],
                sha256=digest,
                track_id=track_id,
                reviewer=name,
                verdict=Verdict(choice),
                note=NOTE,
                took_s=annotation.get("lead_time"),
            )
        )
    return made


def _annotator(completed_by: Any) -> str:
    """Return the number of an annotator: an export has it alone, or in an object."""
    found = completed_by.get("id") if isinstance(completed_by, dict) else completed_by
    return "unnamed" if found is None else str(found)
