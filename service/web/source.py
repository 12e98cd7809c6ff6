"""Data source of a page that runs for days: a state whose service may come and go."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, cast

from service.api.reader import Reader, choose_endpoint
from service.api.state_reader import StateReader
from service.client import ControlClient
from service.errors import NothingFoundError
from service.settings.config import Settings

LOOK_EVERY_S: Final = 0.5
"""Age at which it is looked again if a service runs on the state, seconds."""


class SourceOfState:
    """Reads a state through the service that runs on it now, else from its folder.

    It has the methods of `Reader`. A verdict is always written by the service, if there is one.
    """

    def __init__(self, settings: Settings) -> None:
        """Keep the settings of the state."""
        self._settings = settings
        self._endpoint, self._looked_s = "", -LOOK_EVERY_S

    def __getattr__(self, method: str) -> Any:
        """Return a method of the source that is right now."""
        return getattr(self._now(), method)

    @contextmanager
    def opened(self) -> Iterator[Reader]:
        """Yield the source that is right now, for all questions of one page."""
        source = self._now()
        if isinstance(source, StateReader):
            with source.opened() as opened:
                yield opened
        else:
            yield source

    def _now(self) -> Reader:
        if time.monotonic() - self._looked_s >= LOOK_EVERY_S:
            self._looked_s = time.monotonic()
            try:
                self._endpoint = choose_endpoint(self._settings)
            except NothingFoundError:
                self._endpoint = ""
        if self._endpoint:
            return ControlClient(
                self._endpoint.split(","),
                root=self._settings.root,
                locks=self._settings.client_locks,
            )
        return StateReader(self._settings, now_s=time.clock_gettime(time.CLOCK_REALTIME))


@contextmanager
def opened_once(source: Reader) -> Iterator[Reader]:
    """Yield a source for all questions of one page, so that a database is opened once for them."""
    if isinstance(source, SourceOfState):
        with source.opened() as opened:
            yield opened
    else:
        yield source


def source_of_state(settings: Settings) -> Reader:
    """Return the source of a state folder, with or without a running service."""
    return cast(Reader, SourceOfState(settings))
