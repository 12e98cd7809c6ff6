"""How every process of ours logs and stops: events to stderr, and one orderly way out."""

import logging
import signal
import sys
import threading
from collections.abc import Iterator, MutableMapping
from contextlib import contextmanager
from threading import Event
from types import FrameType, TracebackType
from typing import Any

import structlog


def log_to_stderr(*, level: str = "info", as_json: bool = False) -> None:
    """Send structured events to stderr, one a line; stdout belongs to results.

    Times are UTC. As JSON, what ends the process by surprise is an event as well, its traceback
    within the line; for people a traceback keeps its lines.

    Args:
        level: Least level to show: debug, info, warning, error.
        as_json: Lines for machines instead of for people.
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
                exception_formatter=structlog.dev.plain_traceback,
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
def stop_on_signals() -> Iterator[Event]:
    """Turn the first SIGTERM or SIGINT into a set event; a second one ends the process at once.

    Only the main thread may do this. The former handlers come back at the end.
    """
    stop = Event()

    def on_signal(number: int, _frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)
        stop.set()

    before = {number: signal.signal(number, on_signal) for number in _SIGNALS}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


_SIGNALS = (signal.SIGTERM, signal.SIGINT)


def _on_one_line(
    _logger: object, _method: str, event: MutableMapping[str, Any]
) -> MutableMapping[str, Any]:
    """Escape what would break a line: a path or a store's answer may hold anything."""
    for name, value in event.items():
        if isinstance(value, str) and not value.isprintable():
            event[name] = "".join(
                char if char.isprintable() else char.encode("unicode_escape").decode()
                for char in value
            )
    return event


_former_hooks: list[tuple[Any, Any]] = []
"""Those of the interpreter, or of who runs us, while ours are in their place."""


def _log_surprises(on: bool) -> None:
    if on and not _former_hooks:
        _former_hooks.append((sys.excepthook, threading.excepthook))
        sys.excepthook, threading.excepthook = _log_uncaught, _log_uncaught_in_thread
    elif not on and _former_hooks:
        sys.excepthook, threading.excepthook = _former_hooks.pop()


def _log_uncaught(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    if issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
        return
    structlog.get_logger(__name__).critical("unexpected error", exc_info=(kind, error, trace))


def _log_uncaught_in_thread(args: threading.ExceptHookArgs) -> None:
    error = args.exc_value if args.exc_value is not None else args.exc_type()
    _log_uncaught(args.exc_type, error, args.exc_traceback)
