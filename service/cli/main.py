"""The command `counterpoint`: assembles the verbs, and turns every error into one sentence."""

import sys
from collections.abc import Sequence

import structlog
import typer
from typer.exceptions import Abort, Exit, TyperException

from schemas.errors import PermanentError, TransientError
from schemas.process import log_to_stderr
from service.cli import (
    calibrate,
    daemons,
    demo,
    evaluate,
    logs,
    measure,
    parts,
    rates,
    retry,
    scenes,
    settings,
    simulate,
    weights,
)
from service.cli.output import remark, remark_as_events

EX_SOFTWARE = 70
EX_TEMPFAIL = 75

log = structlog.get_logger(__name__)

app = typer.Typer(
    name="counterpoint",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Find the scenes of a fleet's lidar logs in which two independent streams contradict "
    "each other. No label is needed.",
    epilog="Try it: counterpoint demo --out demo-output",
)
for mining in (daemons, logs, scenes, rates, retry):
    mining.add_to(app)
for measuring in (demo, simulate, evaluate, measure, calibrate, parts, settings, weights):
    measuring.add_to(app)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return 0 when done, 1 for bad input or arguments, 75 to try again.

    What nobody foresaw is our fault: 70, with the trace; who keeps daemons alive may try again.
    """
    log_to_stderr()  # until a verb has read its settings
    remark_as_events(False)
    try:
        ended = typer.main.get_command(app).main(
            args=list(sys.argv[1:] if argv is None else argv),
            prog_name="counterpoint",
            standalone_mode=False,
        )
    except TransientError as error:
        remark(f"try again later: {error}", level="error")
        return EX_TEMPFAIL
    except PermanentError as error:
        remark(f"error: {error}", level="error")
        return 1
    except TyperException as error:
        remark(f"error: {error.format_message()} (--help after the command lists its options)")
        return 1
    except Exit as stop:
        return stop.exit_code
    except (Abort, KeyboardInterrupt):
        return 130
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our pipe has left; nothing is wrong
        return 0
    except Exception:
        log.exception("this is a fault of the program; please report it with these lines")
        return EX_SOFTWARE
    return ended if isinstance(ended, int) else 0


def console() -> None:
    """Entry point of the installed command."""
    sys.exit(main())


if __name__ == "__main__":
    console()
