"""A client that watches scenes from a thread of its own, for as long as a test lasts."""

import threading
from collections.abc import Sequence
from typing import Self

from schemas.transport.keys import DEFAULT_ROOT
from service.client import watch_scenes
from service.client.merge import SceneEvent


class Witness:
    """Watches from the first scene to the last, through every restart.

    Attributes:
        events: Everything that was seen, in order.
    """

    def __init__(self, endpoints: Sequence[str]) -> None:
        """Prepare; the block watches."""
        self.events: list[SceneEvent] = []
        self._endpoints, self._stop = list(endpoints), threading.Event()
        self._thread = threading.Thread(target=self._watch)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        scenes = watch_scenes(self._endpoints, root=DEFAULT_ROOT, stop=self._stop, idle_s=0.5)
        for event in scenes:
            self.events.append(event)
