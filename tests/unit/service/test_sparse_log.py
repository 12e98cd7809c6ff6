"""A flood of refusals leaves a line a second in the log, and their number."""

import structlog.testing

from service.api.sparse_log import INTERVAL_S, SparseLog


def test_a_flood_of_refusals_is_one_line_for_each_verb_and_second() -> None:
    now_s = [100.0]
    refusals = SparseLog(clock=lambda: now_s[0])
    with structlog.testing.capture_logs() as said:
        for _ in range(1000):
            refusals.warn("request refused", asked="commit", problem="no such lease")
            refusals.warn("request refused", asked="top", problem="most: too large")
        now_s[0] += INTERVAL_S
        refusals.warn("request refused", asked="commit", problem="another")
    assert [(entry["asked"], entry["problem"], entry.get("unsaid")) for entry in said] == [
        ("commit", "no such lease", None),
        ("top", "most: too large", None),
        ("commit", "another", 999),
    ]
