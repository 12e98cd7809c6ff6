"""Check of `doctor` on the answer of the model under test: what of it can be judged."""

from collections.abc import Iterator
from importlib.util import find_spec

from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from service.background.skipped_entries import is_wanted
from service.doctor.finding import Finding, ok, warning
from service.settings.config import Settings


def answer(settings: Settings) -> Iterator[Finding]:
    """Read the model's answer to the first frames of the first log, where a stream is recorded."""
    if not settings.takes_recorded or not settings.bucket or find_spec("mcap") is None:
        return
    from workers.ingest.plan import plan_recording
    from workers.model_answer import read_answer

    store = open_bucket(settings.bucket)
    recordings = group_recordings(
        found
        for found in store.list()
        if is_wanted(found.key, include=settings.include, exclude=settings.exclude)
    )
    if not recordings:
        return  # said under `bucket`
    first = recordings[0]
    found = read_answer(store, first, settings.mining())
    if found is None:
        why = plan_recording(store, first, settings.mining()).refused or "it has none"
        yield warning("model's answer", f"the first log is refused: {why} ({first.log_id})")
        return
    for said in found.problems:
        yield warning("model's answer", f"{said} ({first.log_id})")
    complete = not found.reason and not found.unanswered_share
    verdict = ok if complete else warning
    yield verdict("model's answer", f"{found.sentence} ({first.log_id})")
