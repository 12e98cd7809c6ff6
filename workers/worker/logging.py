"""Logging of finished work: a line for each plan and shard, never one per frame.

The log id and the shard are fields bound while a lease is worked on.
"""

from collections.abc import Iterable
from typing import Final

import structlog

from schemas.frame import OdometryState
from schemas.work import Damage, LogPlan
from workers.ingest.footer import TruncatedPart
from workers.mine import Account

log = structlog.get_logger(__name__)

DEGRADED_WORTH_SAYING: Final = 0.1
"""Share of degraded frames in a shard from which they are logged; single degraded poses, at a kerb
or a bump, are normal."""


def tell_truncated(parts: Iterable[TruncatedPart]) -> None:
    """Log every truncated object, and how far it is used."""
    for part in parts:
        log.warning(
            "truncated object: used as far as it goes",
            key=part.key,
            bytes=part.size,
            seconds=round(part.seconds, 1),
        )


def tell_unread_labels(topics: Iterable[str]) -> None:
    """Log the topics with recorded labels of the model on the car that no stream reads."""
    for topic in topics:
        log.info("this log holds recorded labels; judge them by --supervised recorded", topic=topic)


def tell_planned(plan: LogPlan, *, seconds: float) -> None:
    """Log the shards of a plan, or why the log cannot be mined."""
    if plan.refused:
        log.warning("log refused", problem=plan.refused)
        return
    log.info("log planned", shards=len(plan.shards), seconds=round(seconds, 2))
    _tell_damage(plan.damage)


def tell_mined(account: Account, *, seconds: float) -> None:
    """Log the time of a shard, and its faults."""
    log.info("shard mined", scenes=account.scenes, frames=account.frames, seconds=round(seconds, 2))
    _tell_damage(account.damage)
    lost = account.odometry[OdometryState.LOST]
    degraded = account.odometry[OdometryState.DEGRADED]
    if lost or degraded > DEGRADED_WORTH_SAYING * account.frames:
        log.warning(
            "odometry in trouble",
            lost=lost,
            degraded=degraded,
            frames=account.frames,
            problem=account.odometry_problem,
        )


def _tell_damage(damage: Iterable[Damage]) -> None:
    found = list(damage)
    if found:
        log.warning(
            "damaged log: went on after it",
            stretches=len(found),
            bytes=sum(each.bytes for each in found),
            key=found[0].key,
            offset=found[0].offset,
            problem=found[0].what,
        )
