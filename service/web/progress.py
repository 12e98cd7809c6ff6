"""Progress of a reviewer in one phrase: budget, pace, and precision so far."""

from typing import Any, Final, cast

from starlette.requests import Request

from schemas.errors import PermanentError, TransientError
from service.api.reader import Reader
from service.curation.verdicts import AgreementReply, AgreementRequest
from service.web.kept import Kept
from service.web.phrases import grouped, interval

KEPT_S: Final = 5.0
"""Age up to which an answer about all verdicts is used again, seconds."""


class Progress:
    """Sums over all verdicts, or those on a selection, each kept for some seconds."""

    def __init__(self) -> None:
        """Begin with none."""
        self._kept: Kept[AgreementReply] = Kept(age_s=KEPT_S)

    def of(self, source: Reader, selection: str) -> AgreementReply:
        """Return the sums over the verdicts on a selection; empty: on all scenes."""
        asked = AgreementRequest(selection=selection or None)
        return self._kept.of(selection, lambda: source.agreement(asked))

    def forget(self) -> None:
        """Ask again next time, since a verdict was given."""
        self._kept.forget()


def progress_of(request: Request) -> Progress:
    """Return the kept answers of the application."""
    return cast(Progress, request.app.state.progress)


def summary(found: AgreementReply, *, reviewer: str, budget: int) -> dict[str, Any]:
    """Return the progress of a reviewer for a script, and as a phrase.

    Args:
        found: Sums over the verdicts.
        reviewer: The reviewer; empty: not known yet, and the scenes of all count.
        budget: Number of scenes that the reviewer chose; the size of a selection goes before it.
    """
    mine = next((each for each in found.pace if each.reviewer == reviewer), None)
    judged = mine.scenes if mine else 0 if reviewer else found.scenes
    budget = found.budget or budget
    parts = []
    if budget:
        parts.append(f"{grouped(judged)} of {grouped(budget)}")
    elif judged:
        parts.append(f"{grouped(judged)} judged")
    if mine and mine.median_s is not None:
        parts.append(f"{mine.median_s:.0f} s a scene")
    precision = found.precision
    if precision.share is not None and precision.low is not None and precision.high is not None:
        parts.append(f"precision {interval(precision.share, precision.low, precision.high)}")
    return {
        "judged": judged,
        "budget": budget,
        "median_s": mine.median_s if mine else None,
        "precision": precision.model_dump(),
        "text": ", ".join(parts),
    }


def progress_text(request: Request, *, reviewer: str, budget: int) -> str:
    """Return the phrase of a page; empty where the source does not answer."""
    selection = request.query_params.get("selection", "")
    try:
        found = progress_of(request).of(request.app.state.source, selection)
    except (PermanentError, TransientError):
        return ""
    return str(summary(found, reviewer=reviewer, budget=budget)["text"])
