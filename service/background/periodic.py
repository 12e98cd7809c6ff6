"""Periodic work of the service, which retries after errors that may pass."""

from collections.abc import Callable, Iterator
from threading import Event
from typing import Final

import structlog

from schemas.errors import CounterpointError, TransientError
from schemas.runtime.retry import backoff_s
from service.errors import OtherBucketError, StateInUseError, StateUnusableError

log = structlog.get_logger(__name__)

ENDING: Final = (StateUnusableError, StateInUseError, OtherBucketError)
"""Errors that end the service: the state is unusable, in use, or of another bucket."""

FIRST_RETRY_S: Final = 1.0
MOST_RETRY_S: Final = 60.0


def tick(
    work: Callable[[], object],
    *,
    what: str,
    interval_s: float,
    stop: Event,
    alarm: Event | None = None,
    most_retry_s: float | None = None,
    passing: tuple[type[CounterpointError], ...] = (TransientError,),
    ending: tuple[type[CounterpointError], ...] = ENDING,
    on_fault: Callable[[], None] = lambda: None,
) -> None:
    """Repeat the work at an interval until `stop` is set.

    An error that may pass is logged once, and the work is retried. An unexpected error is a fault
    of the program: it is logged with its trace and counted, and the work is retried too, since the
    rest of the service still works. Only `ending` errors end the loop, and with it the service:
    after these every further step could do harm.

    Args:
        work: The work.
        what: Name of the work in the log.
        interval_s: Wait between two calls, seconds.
        stop: Ends the loop.
        alarm: Ends the wait early when set; set it together with `stop`. None: `stop` alone.
        most_retry_s: Longest wait after an error, seconds; None: `MOST_RETRY_S`.
        passing: Errors that may pass. Logged again only when another kind of them follows.
        ending: Errors after which the service must not go on.
        on_fault: Called for every error that is neither.

    Raises:
        CounterpointError: One of `ending`.
    """
    alarm = alarm or stop
    most_s = MOST_RETRY_S if most_retry_s is None else most_retry_s
    waits: Iterator[float] | None = None
    said: type[BaseException] | None = None
    while not stop.is_set():
        try:
            work()
        except ending:
            raise
        except (KeyboardInterrupt, SystemExit):
            raise
        except passing as error:
            if said is not type(error):
                log.warning("trying again", what=what, problem=str(error))
                said = type(error)
            waits = waits or backoff_s(first_s=FIRST_RETRY_S, most_s=most_s)
            stop.wait(next(waits))
            continue
        except BaseException as error:  # also a panic of Zenoh's, which is no `Exception`
            log.error("a fault of the program; trying again", what=what, exc_info=error)
            on_fault()
            said = type(error)
            waits = waits or backoff_s(first_s=FIRST_RETRY_S, most_s=most_s)
            stop.wait(next(waits))
            continue
        if waits is not None:
            log.info("works again", what=what)
            waits, said = None, None
        alarm.wait(interval_s)
        if alarm is not stop:
            alarm.clear()
