"""Whatever is done to the bytes of a log, it is mined or refused, in time and in bounded memory.

`python -m tests.fuzz.logs` mines thousands of them.
"""

from contextlib import closing
from pathlib import Path

import pytest

from tests.fuzz.attempt import Trial
from tests.fuzz.logs import failures
from tests.fuzz.mutations import MUTATIONS
from tests.fuzz.pool import run_all
from tests.fuzz.seeds import CONTAINERS, ENCODINGS, seed_log

pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

SEED = 20_261_123
LOGS = 240
"""Each encoding with each mutation twice: a minute of two processes."""


def test_no_mutated_log_is_more_than_refused() -> None:
    runs = run_all(range(LOGS), seed=SEED, workers=2)
    assert {run.encoding for run in runs} == ENCODINGS.keys()
    assert {run.mutations[0] for run in runs} == MUTATIONS.keys()
    assert not any(run.failed for run in runs), "\n".join(failures(runs))
    mined = sum(run.end == "mined" for run in runs)
    assert LOGS // 4 < mined < LOGS, "nearly all logs end alike: the mutations show nothing"


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_the_logs_that_are_mutated_are_mined_whole(encoding: str, tmp_path: Path) -> None:
    with closing(Trial(tmp_path)) as trial:
        for number, container in enumerate(CONTAINERS):
            data = seed_log(encoding, container, pause_ms=700 * (number % 2)).write()
            outcome = trial.take(f"car-7/2026-03-02/drive-{number}", data)
            assert (outcome.end, outcome.damage) == ("mined", 0), f"{container}: {outcome}"
            assert outcome.scenes >= 2
