"""Entry point of `counterpoint`: assembles the verbs, and reports every error in one sentence."""

import errno
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import version
from types import FrameType
from typing import Annotated, Final

import structlog
import typer
from typer.core import TyperGroup
from typer.exceptions import Abort, Exit, TyperException

from schemas.errors import PermanentError, TransientError
from schemas.runtime.process import log_to_stderr
from service.cli.output import page, remark, remark_as_events, usage
from service.cli.verbs import files_of
from service.errors import UsageError

EX_SOFTWARE = 70
EX_TEMPFAIL = 75

_MAY_PASS: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE})
_OF_THE_MACHINE: Final = _MAY_PASS | {
    *(errno.EACCES, errno.EPERM, errno.EROFS, errno.EIO, errno.ENOENT, errno.ENOTDIR),
    *(errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP, errno.EFBIG, errno.ENXIO, errno.ESTALE),
}
"""Error numbers of disks and permissions, reported here if no verb has reported them better."""

log = structlog.get_logger(__name__)


class _Terminated(BaseException):
    """Raised on SIGTERM, so that a verb removes its temporary files."""


@contextmanager
def _unwound_by_sigterm() -> Iterator[None]:
    """Turn SIGTERM into an exception, as Ctrl-C is; daemons have signal handlers of their own."""

    def on_signal(number: int, _frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)
        raise _Terminated

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, on_signal)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _say_version(wanted: bool) -> None:
    if wanted:
        page(f"counterpoint {version('counterpoint')}\n")
        raise Exit


def _of_every_verb(
    _version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=_say_version, help="Print the version."),
    ] = False,
) -> None:
    """Accept the options in front of any verb."""


def app_of(verb: str | None = None) -> typer.Typer:
    """Return the command with this verb alone; without one, or for an unknown one, with all.

    To load all verbs takes a second, most of them a third of that.
    """
    app = typer.Typer(
        name="counterpoint",
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        help="Find the scenes of a fleet's lidar logs in which two independent streams contradict "
        "each other. No label is needed.",
        epilog="Try it: counterpoint demo --out demo-output",
        callback=_of_every_verb,
    )
    for file in files_of(verb):
        file.add_to(app)
    return app


@cache
def _command(verb: str | None) -> TyperGroup:
    """Build the command once in a process."""
    return typer.main.get_group(app_of(verb))


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return 0 when done, 1 for bad input or arguments, 75 to try again.

    `run --once` returns 3 if work is parked: all else is mined, but its scenes are missing. An
    unexpected error is a fault of the program: 70, with the trace; a supervisor of daemons may try
    again.
    """
    log_to_stderr()  # until a verb has read its settings
    remark_as_events(False)
    try:
        arguments = _need_text(sys.argv[1:] if argv is None else argv)
        with _unwound_by_sigterm():
            ended = _command(next(iter(arguments), None)).main(
                args=arguments,
                prog_name="counterpoint",
                standalone_mode=False,
            )
        sys.stdout.flush()  # a full disk is said here, and not by the interpreter as it ends
    except TransientError as error:
        remark(f"try again later: {error}", level="error")
        return EX_TEMPFAIL
    except PermanentError as error:
        remark(f"error: {error}", level="error")
        return 1
    except TyperException as error:
        if type(error).__name__ == "NoArgsIsHelpError":  # Typer does not export it
            usage(error.format_message())
            return 1
        remark(f"error: {error.format_message()} (--help after the command lists its options)")
        return 1
    except Exit as stop:
        return stop.exit_code
    except (Abort, KeyboardInterrupt):
        return 130
    except _Terminated:
        return 143
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our pipe has left; nothing is wrong
        return 0
    except Exception as error:
        if isinstance(error, OSError) and error.errno in _OF_THE_MACHINE:
            log.debug("the operating system refused", exc_info=True)
            return _say_refused(error)
        log.exception("this is a fault of the program; please report it with these lines")
        return EX_SOFTWARE
    return ended if isinstance(ended, int) else 0


def _say_refused(error: OSError) -> int:
    """Report an error of a disk or its permissions, where no verb has reported it better."""
    where = f" ({os.fsdecode(error.filename)})" if error.filename else ""
    if not where:  # results, most likely, which the interpreter would write again as it ends
        _let_go_of_stdout()
    remark(f"error: the operating system refuses: {error.strerror}{where}", level="error")
    return EX_TEMPFAIL if error.errno in _MAY_PASS else 1


def _need_text(argv: Sequence[str]) -> list[str]:
    """Refuse arguments that are not valid text, which neither stores nor databases accept.

    Raises:
        UsageError: If one is not UTF-8 or has a NUL character.
    """
    for argument in argv:
        if "\0" in argument or any("\ud800" <= char <= "\udfff" for char in argument):
            raise UsageError(f"this argument is not UTF-8 text: {argument}; rename what it names")
    return list(argv)


def _let_go_of_stdout() -> None:
    """Discard unwritten output, so that the interpreter does not try again at its end."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def console() -> None:
    """Entry point of the installed command."""
    sys.exit(main())


if __name__ == "__main__":
    console()
