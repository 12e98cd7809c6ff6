"""Logging and shutdown of every process: events to stderr, and an orderly stop on signals."""

import logging
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import contextmanager
from threading import Event
from types import FrameType, TracebackType
from typing import Any, Final, TextIO

import structlog

from schemas.visible import NEWLINES, visible


def log_to_stderr(*, level: str = "info", as_json: bool = False) -> None:
    """Send structured events to stderr, one a line; stdout belongs to results.

    Times are UTC. In JSON, an uncaught exception is an event as well, with its traceback within the
    line; in plain text a traceback keeps its lines. No value reaches a terminal with a control
    character in it.

    Args:
        level: Least level to show: debug, info, warning, error.
        as_json: Write JSON lines instead of plain text.
    """
    render: list[structlog.typing.Processor] = (
        [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
        if as_json
        else [
            _on_one_line,
            structlog.dev.ConsoleRenderer(
                colors=sys.stderr.isatty(),
                pad_event_to=0,
                sort_keys=False,
                exception_formatter=_say_trace,
            ),
        ]
    )
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            *render,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(
            logging.getLevelNamesMapping()[level.upper()]
        ),
        # Looked up for each line: a progress bar puts its own stderr in place while it is drawn.
        logger_factory=lambda *_: structlog.WriteLogger(sys.stderr),
        cache_logger_on_first_use=False,
    )
    _log_surprises(as_json)


@contextmanager
def stop_on_signals(on_stop: Callable[[], None] = lambda: None) -> Iterator[Event]:
    """Turn the first SIGTERM or SIGINT into a set event; a second one ends the process at once.

    Only the main thread may call this. The former handlers are restored at the end.

    Args:
        on_stop: Called once after the first signal, from a thread: a handler of signals may
            interrupt a line that is being printed, and must print none itself.
    """
    stop, woken = Event(), Event()

    def on_signal(number: int, _frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)
        stop.set()
        woken.set()

    def tell() -> None:
        woken.wait()
        if stop.is_set():
            on_stop()

    teller = threading.Thread(target=tell, name="stop", daemon=True)
    before = {number: signal.signal(number, on_signal) for number in _SIGNALS}
    teller.start()
    try:
        yield stop
    finally:
        woken.set()
        teller.join(_TELL_S)
        for number, handler in before.items():
            signal.signal(number, handler)


_TELL_S: Final = 1.0
"""Longest wait for `on_stop` at the end, seconds: its terminal may be gone."""

_SIGNALS = (signal.SIGTERM, signal.SIGINT)


def _on_one_line(
    _logger: object, _method: str, event: MutableMapping[str, Any]
) -> MutableMapping[str, Any]:
    """Escape characters that a terminal obeys or that break a line; values may contain anything."""
    for name, value in list(event.items()):
        if not name.isprintable():
            event[visible(name)] = event.pop(name)
        if name != "exc_info" and not isinstance(value, bool | int | float | None):
            event[visible(name)] = visible(str(value) if isinstance(value, str) else repr(value))
    return event


def _say_trace(out: TextIO, exc_info: structlog.typing.ExcInfo) -> None:
    lines = traceback.format_exception(*exc_info)
    out.write("\n" + visible("".join(lines).rstrip("\n"), keep=NEWLINES))


_former_hooks: list[tuple[Any, Any]] = []
"""Exception hooks of the interpreter or of an embedding program, kept while ours are installed."""


def _log_surprises(as_json: bool) -> None:
    if not _former_hooks:
        _former_hooks.append((sys.excepthook, threading.excepthook))
    if as_json:
        sys.excepthook, threading.excepthook = _log_uncaught, _log_uncaught_in_thread
        return
    sys.excepthook, threading.excepthook = _former_hooks[0]
    if sys.excepthook is sys.__excepthook__:  # who put another in its place wants that one
        sys.excepthook = _print_uncaught
    if threading.excepthook is threading.__excepthook__:
        threading.excepthook = _print_uncaught_in_thread


def _log_uncaught(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    if issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
        return
    structlog.get_logger(__name__).critical("unexpected error", exc_info=(kind, error, trace))


def _print_uncaught(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    lines = traceback.format_exception(kind, error, trace)
    sys.stderr.write(visible("".join(lines), keep=NEWLINES))


def _print_uncaught_in_thread(args: threading.ExceptHookArgs) -> None:
    error = args.exc_value if args.exc_value is not None else args.exc_type()
    sys.stderr.write(f"in thread {visible(args.thread.name) if args.thread else 'of none'}:\n")
    _print_uncaught(args.exc_type, error, args.exc_traceback)


def _log_uncaught_in_thread(args: threading.ExceptHookArgs) -> None:
    error = args.exc_value if args.exc_value is not None else args.exc_type()
    _log_uncaught(args.exc_type, error, args.exc_traceback)
