"""Writers killed without warning, several times: what they acknowledged is there."""

import subprocess
import sys
from pathlib import Path

import pytest

from service.store.engine import open_store
from tests.contracts.ledger_world import World, expected_scenes

ROOT = Path(__file__).resolve().parents[2]
LOGS = [f"log-{number}" for number in range(40)]

WRITER = """
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from schemas.work import NothingToDo, PlanLease
from service.store.engine import open_store
from tests.contracts.ledger_world import World, manifest_of, mined

world = World.on(open_store(Path(sys.argv[1])))
world.listed(*sys.argv[3:])
world.ledger.free_leases("")

def work(worker):
    while not isinstance(grant := world.claim(worker), NothingToDo):
        if isinstance(grant, PlanLease):
            assert world.commit_plan(grant, worker).ok
        else:
            assert world.commit_shard(grant, worker).ok
            for entry in manifest_of(mined(grant.shard)):
                sys.stdout.write(f"{entry.scene_id} {entry.sha256}\\n")
            sys.stdout.flush()

with ThreadPoolExecutor(int(sys.argv[2])) as pool:
    list(pool.map(work, [f"w{number}" for number in range(int(sys.argv[2]))]))
"""


@pytest.mark.integration
@pytest.mark.parametrize("threads", [1, 8], ids=["each alone", "in groups"])
def test_what_was_acknowledged_survives_kill_9_of_the_writer(tmp_path: Path, threads: int) -> None:
    acknowledged: dict[str, str] = {}
    for lines in (1, 40, 75, 100):
        with subprocess.Popen(
            [sys.executable, "-c", WRITER, str(tmp_path), str(threads), *LOGS],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            text=True,
        ) as writer:
            assert writer.stdout is not None
            said = [writer.stdout.readline() for _ in range(lines)]
            writer.kill()
            said += writer.stdout.readlines()
        whole = [line.split() for line in said if line.endswith("\n")]
        assert len(whole) >= lines
        acknowledged.update(dict(whole))
        store = open_store(tmp_path)
        stored = {scene.scene_id: scene.sha256 for scene in World.on(store).ledger.current_scenes()}
        store.close()
        assert acknowledged.items() <= stored.items()
    store = open_store(tmp_path)
    world = World.on(store)
    world.ledger.free_leases("")
    world.mine_all()
    scenes = world.ledger.current_scenes()
    assert {scene.scene_id: scene.sha256 for scene in scenes} == expected_scenes(LOGS)
    assert [scene.seq for scene in scenes] == list(range(1, len(scenes) + 1))
    store.close()
