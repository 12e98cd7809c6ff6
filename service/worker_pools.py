"""Pools of workers for a service elsewhere: processes of this machine, or actors of Ray."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from threading import Event
from typing import TYPE_CHECKING

from schemas.transport.bus import client_session
from schemas.transport.keys import OWNER_END
from service.settings.config import Settings, cache_folder
from service.work_left import work_left

if TYPE_CHECKING:
    from workers.pool.local import LocalPool
    from workers.pool.ray_pool import RayPool
    from workers.worker.config import Accepted


def local_pool(
    settings: Settings, connect: Sequence[str], _opened: ExitStack, _stop: Event
) -> "LocalPool":
    """Return the pool of processes on this machine that `worker` keeps alive."""
    from workers.pool.local import LocalPool
    from workers.pool.process import LogStyle

    return LocalPool(
        settings.workers,
        connect=connect,
        root=settings.root,
        home=cache_folder(),
        lease_deadline_s=settings.shard_deadline_s,
        style=LogStyle(settings.log_level, settings.log_format == "json"),
        name=_pool_name(settings, "worker"),
        accepts=accepted_by(settings),
        locks=settings.locks,
    )


def ray_pool(
    settings: Settings, connect: Sequence[str], opened: ExitStack, stop: Event
) -> "RayPool":
    """Return the pool of actors of a Ray cluster that `worker` keeps alive."""
    from workers.pool.process import LogStyle
    from workers.pool.ray_pool import RayOptions, RayPool

    backlog: Callable[[], int] | None = None
    if settings.ray_most_workers > settings.workers:
        session = opened.enter_context(client_session(connect, stop=stop, locks=settings.locks))
        backlog = partial(work_left, session, settings.root)
    return RayPool(
        RayOptions(
            settings.ray_address,
            least=settings.workers,
            most=max(settings.workers, settings.ray_most_workers),
            cpus=settings.ray_cpus,
            gpus=settings.ray_gpus,
        ),
        connect=connect,
        root=settings.root,
        name=_pool_name(settings, "ray"),
        lease_deadline_s=settings.shard_deadline_s,
        style=LogStyle(settings.log_level, settings.log_format == "json"),
        accepts=accepted_by(settings),
        locks=settings.locks,
        backlog=backlog,
    )


def accepted_by(settings: Settings) -> "Accepted":
    """Return the locations that workers with these settings accept from a service elsewhere."""
    from workers.worker.config import Accepted

    return Accepted(
        settings.bucket,
        settings.artifacts_url,
        settings.model,
        settings.weights,
        settings.predictions,
    )


def _pool_name(settings: Settings, name: str) -> str:
    """Return the first part of the workers' ids: the certificate's name binds them to it."""
    owner = settings.locks.name
    return f"{owner}{OWNER_END}{name}" if owner else name
