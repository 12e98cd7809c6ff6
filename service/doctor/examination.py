"""Run of `counterpoint doctor`: checks all prerequisites, one finding each, with a remedy."""

from collections.abc import Callable, Iterator
from typing import Final

from schemas.errors import CounterpointError
from service.doctor.finding import Finding, ok, problem
from service.settings.config import ReadSettings, Settings


def examine(read: ReadSettings) -> Iterator[Finding]:
    """Run all checks in turn; they write nothing but one small object into the artifacts.

    Args:
        read: Settings to check.

    Yields:
        Findings, each when it is made; a part may have several. Impossible checks are reported too.
    """
    from service.doctor import answers as doctor_answers
    from service.doctor import machine as doctor_machine
    from service.doctor import network as doctor_network
    from service.doctor import stores as doctor_stores

    settings = read.settings
    yield _settings(read)
    checks: Final[tuple[tuple[str, Callable[[Settings], Iterator[Finding]]], ...]] = (
        ("bucket", doctor_stores.bucket),
        ("artifacts", doctor_stores.artifacts),
        ("state", doctor_stores.state),
        ("database", doctor_stores.database),
        ("router", doctor_network.router),
        ("http", doctor_network.http),
        ("locks", doctor_network.locks),
        ("camera", doctor_machine.camera),
        ("workers", doctor_machine.parts),
        ("model's answer", doctor_answers.answer),
        ("devices", doctor_machine.devices),
        ("compiled code", doctor_machine.compiled_code),
        ("clock", doctor_machine.clock),
    )
    for what, check in checks:
        try:
            yield from check(settings)
        except CounterpointError as error:  # whatever we raise names what to mend
            yield problem(what, str(error))


def _settings(read: ReadSettings) -> Finding:
    changed = ", ".join(sorted(read.written)) or "none"
    file = f"file {read.file}" if read.file else "no file"
    return ok("settings", f"all valid; changed: {changed} ({file})")
