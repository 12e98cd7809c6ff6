"""Deletions of overlays that the settings ask for: by age, and by a disk budget."""

from schemas.transport.bucket import open_bucket
from service.background.overlay_budget import OverlayBudget
from service.background.overlay_cleanup import DAY_S, OverlaySweep
from service.settings.config import Settings
from service.store.ledger import Ledger


def overlay_sweeps(
    settings: Settings, ledger: Ledger, *, log_bucket_url: str
) -> tuple[list[OverlaySweep | OverlayBudget], OverlayBudget | None]:
    """Return every deletion, and the one by budget among them; None: there is no budget.

    Raises:
        UsageError: If overlays are to be deleted in the log bucket.
    """
    sweeps: list[OverlaySweep | OverlayBudget] = []
    budget, artifacts_url = None, settings.mining().artifacts
    if settings.keep_withdrawn_days:
        sweeps.append(
            OverlaySweep(
                open_bucket(artifacts_url, create=True),
                ledger,
                keep_s=settings.keep_withdrawn_days * DAY_S,
                log_bucket_url=log_bucket_url,
                keep_pipelines=settings.keep_pipelines,
            )
        )
    if settings.artifacts_budget_bytes:
        budget = OverlayBudget(
            open_bucket(artifacts_url, create=True),
            ledger,
            budget_bytes=settings.artifacts_budget_bytes,
            log_bucket_url=log_bucket_url,
            keep_pipelines=settings.keep_pipelines,
        )
        sweeps.append(budget)
    return sweeps, budget
