"""One finding of `counterpoint doctor`: a verdict, and a remedy for a problem."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

Verdict = Literal["ok", "warning", "problem"]


class Finding(BaseModel):
    """Result of one check."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    what: str = Field(description="The part that was checked.")
    verdict: Verdict = Field(
        description="problem: it will not work; warning: it works with a limitation."
    )
    says: str = Field(description="Result and remedy in one sentence.")


def ok(what: str, says: str) -> Finding:
    """Report that a part is in order."""
    return Finding(what=what, verdict="ok", says=says)


def warning(what: str, says: str) -> Finding:
    """Report that a part works, but with a limitation."""
    return Finding(what=what, verdict="warning", says=says)


def problem(what: str, says: str) -> Finding:
    """Report that a part will not work."""
    return Finding(what=what, verdict="problem", says=says)
