"""What a worker's log says of finished work: a line for each plan and shard, never one per frame.

Which log and which shard it was stands in the fields that are bound while a lease is worked on.
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
"""Of a shard's frames: single degraded poses, at a kerb or a bump, are everyday."""


def tell_truncated(parts: Iterable[TruncatedPart]) -> None:
    """Say of every object that was never closed how far it is used."""
    for part in parts:
        log.warning(
            "truncated object: used as far as it goes",
            key=part.key,
            bytes=part.size,
            seconds=round(part.seconds, 1),
        )


def tell_unread_labels(topics: Iterable[str]) -> None:
    """Say on which topics a log holds labels of the model on the car that nobody judges."""
    for topic in topics:
        log.info("this log holds recorded labels; judge them by --supervised recorded", topic=topic)


def tell_planned(plan: LogPlan, *, seconds: float) -> None:
    """Say what a log holds, or why it cannot be mined."""
    if plan.refused:
        log.warning("log refused", problem=plan.refused)
        return
    log.info("log planned", shards=len(plan.shards), seconds=round(seconds, 2))
    _tell_damage(plan.damage)


def tell_mined(account: Account, *, seconds: float) -> None:
    """Say what a shard took, and what was wrong with it."""
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
