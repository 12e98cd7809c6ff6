"""Work that is done again and again while the service lives, and waits out what may pass."""

from collections.abc import Callable, Iterator
from threading import Event
from typing import Final

import structlog

from schemas.errors import CounterpointError, TransientError
from schemas.runtime.retry import backoff_s
from service.errors import OtherBucketError, StateInUseError, StateUnusableError
from service.store.single_writer_lock import DatabaseTakenError

log = structlog.get_logger(__name__)

ENDING: Final = (StateUnusableError, StateInUseError, OtherBucketError, DatabaseTakenError)
"""The state cannot be used, is another service's, or is that of another bucket."""

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
    """Do the work, wait, and do it again, until told to stop.

    What may pass is said once and waited out. What nobody foresaw is a fault of the program: it is
    logged with its trace, counted, and the work is tried again like what may pass, since a service
    that still does the rest of its work is worth more than none. Only `ending` errors end the
    loop, and with it the service: then every further step could do harm.

    Args:
        work: What to do.
        what: What the log calls it.
        interval_s: Wait between two times, seconds.
        stop: Ends the loop.
        alarm: Whoever sets it ends the wait early; set it together with `stop`. None: `stop` alone.
        most_retry_s: Longest wait after an error, seconds; None: `MOST_RETRY_S`.
        passing: Errors that may pass. Said again only when another kind of them follows.
        ending: Errors after which the service must not go on.
        on_fault: Told of every error that is neither.

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
