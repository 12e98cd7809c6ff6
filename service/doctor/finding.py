"""One finding of `counterpoint doctor`: its verdict, and how to mend what is wrong."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

Verdict = Literal["ok", "warning", "problem"]


class Finding(BaseModel):
    """One thing that was looked at."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    what: str = Field(description="The part that was looked at.")
    verdict: Verdict = Field(description="problem: it will not work; warning: look at it.")
    says: str = Field(description="What was found, and what to mend, in one sentence.")


def ok(what: str, says: str) -> Finding:
    """Say that a part is as it should be."""
    return Finding(what=what, verdict="ok", says=says)


def warning(what: str, says: str) -> Finding:
    """Say that a part works, but not as it could."""
    return Finding(what=what, verdict="warning", says=says)


def problem(what: str, says: str) -> Finding:
    """Say that a part will not work."""
    return Finding(what=what, verdict="problem", says=says)
