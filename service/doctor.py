"""`counterpoint doctor`: looks at everything a run needs, one sentence each, and what to mend."""

from collections.abc import Callable, Iterator
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from schemas.errors import CounterpointError
from service.config import ReadSettings, Settings

Verdict = Literal["ok", "warning", "problem"]


class Finding(BaseModel):
    """One thing that was looked at."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    what: str = Field(description="The part that was looked at.")
    verdict: Verdict = Field(description="problem: it will not work; warning: look at it.")
    says: str = Field(description="What was found, and what to mend, in one sentence.")


def examine(read: ReadSettings) -> Iterator[Finding]:
    """Look at everything in turn; nothing is written but one small probe into the artifacts.

    Args:
        read: The settings to check the world against.

    Yields:
        Findings as they are made; a part may have several. What cannot be checked is said.
    """
    from service import doctor_machine, doctor_network, doctor_stores

    settings = read.settings
    yield _settings(read)
    checks: Final[tuple[tuple[str, Callable[[Settings], Iterator[Finding]]], ...]] = (
        ("bucket", doctor_stores.bucket),
        ("artifacts", doctor_stores.artifacts),
        ("state", doctor_stores.state),
        ("database", doctor_stores.database),
        ("router", doctor_network.router),
        ("http", doctor_network.http),
        ("camera", doctor_machine.camera),
        ("workers", doctor_machine.parts),
        ("devices", doctor_machine.devices),
        ("compiled code", doctor_machine.compiled_code),
        ("clock", doctor_machine.clock),
    )
    for what, check in checks:
        try:
            yield from check(settings)
        except CounterpointError as error:  # whatever we raise names what to mend
            yield problem(what, str(error))


def ok(what: str, says: str) -> Finding:
    """Say that a part is as it should be."""
    return Finding(what=what, verdict="ok", says=says)


def warning(what: str, says: str) -> Finding:
    """Say that a part works, but not as it could."""
    return Finding(what=what, verdict="warning", says=says)


def problem(what: str, says: str) -> Finding:
    """Say that a part will not work."""
    return Finding(what=what, verdict="problem", says=says)


def _settings(read: ReadSettings) -> Finding:
    changed = ", ".join(sorted(read.written)) or "none"
    file = f"file {read.file}" if read.file else "no file"
    return ok("settings", f"all possible; given: {changed} ({file})")
