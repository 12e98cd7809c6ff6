import subprocess
import sys

import pytest

EQUIPPED = """
import sys
import workers.worker.loop
from schemas.mining import MiningSettings
from workers.worker.worker_context import build_context

settings = MiningSettings(bucket="memory://", artifacts="memory://", supervised=sys.argv[1])
build_context(settings)
workers.worker.loop.limit_threads()
if "torch" in sys.modules:
    import torch

    print(torch.get_num_threads())
"""


@pytest.mark.parametrize(("supervised", "said"), [("recorded", ""), ("salsanext-lmnet", "1")])
def test_a_worker_loads_torch_only_for_parts_that_need_it_and_then_uses_one_thread(
    supervised: str, said: str
) -> None:
    command = [sys.executable, "-c", EQUIPPED, supervised]
    asked = subprocess.run(command, capture_output=True, text=True, check=True)
    assert asked.stdout.strip() == said
