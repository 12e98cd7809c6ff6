"""Logging of finished work: a line for each plan and shard, never one per frame.

The log id and the shard are fields bound while a lease is worked on.
"""

from collections.abc import Iterable
from typing import Final

import structlog

from schemas.frame import OdometryState
from schemas.work import Damage, LogPlan
from workers.ingest.footer import TruncatedPart
from workers.mine import MiningReport

log = structlog.get_logger(__name__)

DEGRADED_LOG_SHARE: Final = 0.1
"""Share of degraded frames in a shard from which they are logged; single degraded poses, at a kerb
or a bump, are normal."""


def log_truncated(parts: Iterable[TruncatedPart]) -> None:
    """Log every truncated object, and how far it is used."""
    for part in parts:
        log.warning(
            "truncated object: used up to its last complete record",
            key=part.key,
            bytes=part.size,
            seconds=round(part.seconds, 1),
        )


def log_unread_labels(topics: Iterable[str]) -> None:
    """Log the topics with recorded labels of the model on the car that no stream reads."""
    for topic in topics:
        log.info("this log has recorded labels; compare them by --supervised recorded", topic=topic)


def log_planned(plan: LogPlan, *, seconds: float) -> None:
    """Log the shards of a plan, or why the log cannot be mined."""
    if plan.refused:
        log.warning("log refused", problem=plan.refused)
        return
    log.info("log planned", shards=len(plan.shards), seconds=round(seconds, 2))
    _log_damage(plan.damage)


def log_mined(report: MiningReport, *, seconds: float) -> None:
    """Log the time of a shard, and its faults."""
    log.info("shard mined", scenes=report.scenes, frames=report.frames, seconds=round(seconds, 2))
    _log_damage(report.damage)
    lost = report.odometry[OdometryState.LOST]
    degraded = report.odometry[OdometryState.DEGRADED]
    if lost or degraded > DEGRADED_LOG_SHARE * report.frames:
        log.warning(
            "odometry unreliable",
            lost=lost,
            degraded=degraded,
            frames=report.frames,
            problem=report.odometry_problem,
        )


def _log_damage(damage: Iterable[Damage]) -> None:
    every = list(damage)
    for each in every:
        if each.is_notice:
            log.warning("noticed in a log, which is mined", key=each.key, problem=each.what)
    found = [each for each in every if not each.is_notice]
    if found:
        log.warning(
            "damaged log: unreadable stretches skipped",
            stretches=len(found),
            bytes=sum(each.bytes for each in found),
            key=found[0].key,
            offset=found[0].offset,
            problem=found[0].what,
        )
