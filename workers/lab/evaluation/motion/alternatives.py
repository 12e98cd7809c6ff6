"""Streams under evaluation, by name: those of the settings, or individual parts."""

from collections.abc import Iterable
from typing import Final

from schemas.mining import MiningSettings
from schemas.task import MOTION
from workers.errors import UnknownPartError
from workers.lab.evaluation.motion.counts import StreamName
from workers.lab.evaluation.motion.dufomap import NAME as DUFOMAP
from workers.lab.evaluation.motion.dufomap import Dufomap
from workers.parts.catalogue import names_of
from workers.parts.protocols import Stream
from workers.parts.registry import build_selfsupervised, build_supervised
from workers.version import files_of

OF_SETTINGS: Final[tuple[StreamName, ...]] = ("selfsupervised", "supervised")
"""Names of the two streams whose parts the settings choose."""


def is_supervised(name: StreamName) -> bool:
    """Say whether a stream's labels come of a supervised model."""
    return name == "supervised" or name in names_of("supervised")


def build_streams(
    names: Iterable[StreamName], settings: MiningSettings
) -> dict[StreamName, Stream]:
    """Build streams by name, each once, in the order given.

    Args:
        names: `selfsupervised`, `supervised`, a part of either kind, or `dufomap`.
        settings: Settings that choose the parts of the first two.

    Raises:
        UnknownPartError: If a stream does not exist, with the known names in the message; or if its
            task is not motion.
    """
    streams = {name: _build(name, settings) for name in dict.fromkeys(names)}
    for name, stream in streams.items():
        if stream.task != MOTION:
            raise UnknownPartError(
                f"stream {name!r} has the task {stream.task.name}; motion is evaluated here"
            )
    return streams


def _build(name: StreamName, settings: MiningSettings) -> Stream:
    if name in OF_SETTINGS:
        if is_supervised(name):
            return build_supervised(settings.supervised, files_of(settings))
        return build_selfsupervised(settings.selfsupervised, files_of(settings))
    if name == DUFOMAP:
        return Dufomap()
    if name in names_of("supervised"):
        return build_supervised(name, files_of(settings))
    if name in names_of("selfsupervised"):
        return build_selfsupervised(name, files_of(settings))
    parts = [*sorted(names_of("selfsupervised")), *sorted(names_of("supervised"))]
    known = ", ".join([*OF_SETTINGS, *parts, DUFOMAP])
    raise UnknownPartError(f"no stream {name!r}; known: {known}")
