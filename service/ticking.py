"""Work that is done again and again while the service lives, and waits out what may pass."""

from collections.abc import Callable
from threading import Event
from typing import Final

import structlog

from schemas.errors import CounterpointError, TransientError
from schemas.retry import backoff_s

log = structlog.get_logger(__name__)

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
) -> None:
    """Do the work, wait, and do it again, until told to stop.

    What may pass is said once and waited out; every other error ends the loop, and with it the
    service, since nobody would notice a thread that is no more.

    Args:
        work: What to do.
        what: What the log calls it.
        interval_s: Wait between two times, seconds.
        stop: Ends the loop.
        alarm: Whoever sets it ends the wait early; set it together with `stop`. None: `stop` alone.
        most_retry_s: Longest wait after an error, seconds; None: `MOST_RETRY_S`.
        passing: Errors that may pass. Said again only when another kind of them follows.
    """
    alarm = alarm or stop
    waits, said = None, None
    while not stop.is_set():
        try:
            work()
        except passing as error:
            if said is not type(error):
                log.warning("trying again", what=what, problem=str(error))
                said = type(error)
            waits = waits or backoff_s(
                first_s=FIRST_RETRY_S, most_s=MOST_RETRY_S if most_retry_s is None else most_retry_s
            )
            stop.wait(next(waits))
            continue
        if waits is not None:
            log.info("works again", what=what)
            waits, said = None, None
        alarm.wait(interval_s)
        if alarm is not stop:
            alarm.clear()
