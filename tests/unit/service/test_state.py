"""Who holds the state folder, and who may look."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from service.errors import StateInUseError, StateUnusableError
from service.store.state import LOCK_NAME, StateLock, endpoint_of_running, prepare_state


def test_a_folder_is_made_when_it_is_missing(tmp_path: Path) -> None:
    prepare_state(tmp_path / "deep" / "state")
    assert list((tmp_path / "deep" / "state").iterdir()) == []


def test_a_state_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "state").write_text("")
    with pytest.raises(StateUnusableError, match=r"cannot write the state folder: .*--state"):
        prepare_state(tmp_path / "state")


def test_a_folder_that_cannot_be_written_is_refused() -> None:
    # Nobody can make files in /proc, not even root, for whom permissions mean nothing.
    with pytest.raises(StateUnusableError, match="cannot write the state folder"):
        prepare_state(Path("/proc"))


def test_a_second_service_is_refused_and_told_where_the_first_is(tmp_path: Path) -> None:
    with (
        StateLock(tmp_path, endpoint="tcp/127.0.0.1:7447"),
        pytest.raises(StateInUseError, match=rf"process {os.getpid()} at tcp/127.0.0.1:7447"),
    ):
        StateLock(tmp_path)


def test_anyone_can_ask_where_the_service_is(tmp_path: Path) -> None:
    assert endpoint_of_running(tmp_path / "nowhere") is None
    with StateLock(tmp_path) as lock:
        assert endpoint_of_running(tmp_path) == ""
        lock.announce("tcp/127.0.0.1:50123")
        assert endpoint_of_running(tmp_path) == "tcp/127.0.0.1:50123"
        lock.announce("tcp/a:1")
        assert endpoint_of_running(tmp_path) == "tcp/a:1"
    assert endpoint_of_running(tmp_path) is None


def test_a_released_folder_can_be_taken_again(tmp_path: Path) -> None:
    StateLock(tmp_path, endpoint="tcp/a:1").release()
    with StateLock(tmp_path, endpoint="tcp/a:2"):
        assert endpoint_of_running(tmp_path) == "tcp/a:2"


def test_what_a_dead_service_wrote_into_the_lock_does_not_count(tmp_path: Path) -> None:
    (tmp_path / LOCK_NAME).write_text(json.dumps({"pid": 1, "endpoint": "tcp/dead:1"}))
    assert endpoint_of_running(tmp_path) is None
    StateLock(tmp_path).release()


def test_looking_at_the_lock_does_not_keep_a_service_from_starting(tmp_path: Path) -> None:
    script = (
        "import sys; from pathlib import Path\n"
        "from service.store.state import endpoint_of_running\n"
        "print(flush=True)\n"
        "while True: endpoint_of_running(Path(sys.argv[1]))\n"
    )
    (tmp_path / LOCK_NAME).touch()
    with subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE
    ) as looker:
        assert looker.stdout is not None
        looker.stdout.readline()
        for _ in range(5):
            StateLock(tmp_path).release()
        looker.kill()
