"""Every event of a process is one line on stderr, for people or for machines."""

import json
import subprocess
import sys

import pytest


def said(code: str, *, as_json: bool = True, level: str = "info") -> list[str]:
    """What a process says that logs in this format and then runs the code."""
    script = (
        "import structlog, threading\nfrom schemas.runtime.process import log_to_stderr\n"
        f"log_to_stderr(as_json={as_json}, level={level!r})\nlog = structlog.get_logger()\n{code}"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert ran.stdout == ""
    return ran.stderr.splitlines()


@pytest.mark.parametrize("as_json", [False, True])
def test_a_value_with_newlines_stays_on_its_line(as_json: bool) -> None:
    lines = said("log.info('one', log_id='a\\nb\\x1b[31m\\u2028c')", as_json=as_json)
    assert len(lines) == 1
    assert "a\\nb" in lines[0]
    assert "\x1b[31m" not in lines[0]


def test_json_has_the_ids_as_fields_and_utc_times() -> None:
    code = "structlog.contextvars.bind_contextvars(log_id='car-7')\nlog.warning('x', shard='s')"
    (event,) = map(json.loads, said(code))
    assert (event["event"], event["level"], event["log_id"]) == ("x", "warning", "car-7")
    assert event["shard"] == "s"
    assert event["timestamp"].endswith("Z")


def test_an_exception_is_one_line_of_json() -> None:
    (event,) = map(json.loads, said("try: 1 / 0\nexcept ZeroDivisionError: log.exception('oh')"))
    assert event["event"] == "oh"
    assert "ZeroDivisionError" in event["exception"]


def test_what_ends_a_process_or_a_thread_by_surprise_is_one_line_of_json() -> None:
    code = (
        "thread = threading.Thread(target=lambda: 1 / 0)\nthread.start()\nthread.join()\n"
        "raise LookupError('nothing')"
    )
    in_thread, in_main = map(json.loads, said(code))
    assert "ZeroDivisionError" in in_thread["exception"]
    assert "LookupError: nothing" in in_main["exception"]
    assert in_main["level"] == "critical"


def test_for_people_a_traceback_keeps_its_lines() -> None:
    lines = said("try: 1 / 0\nexcept ZeroDivisionError: log.exception('oh')", as_json=False)
    assert "[error" in lines[0]
    assert lines[-1].startswith("ZeroDivisionError")


def test_less_than_the_level_is_not_said() -> None:
    assert len(said("log.debug('a')\nlog.info('b')\nlog.warning('c')", level="warning")) == 1


STEERING = r"'\x1b]52;c;aGk=\x07\x9b31m\u202ea\nb'"
LOGGED = {
    "event": f"log.warning({STEERING})",
    "text": f"log.warning('x', vehicle={STEERING})",
    "name": f"log.warning('x', **{{{STEERING}: 1}})",
    "list": f"log.warning('x', topics=[{STEERING}])",
    "error": f"log.warning('x', problem=ValueError({STEERING}))",
    "trace": f"try: raise ValueError({STEERING})\nexcept ValueError: log.exception('oh')",
    "surprise": f"raise ValueError({STEERING})",
    "thread": f"def f(): raise ValueError({STEERING})\nthreading.Thread(target=f).start()",
}


@pytest.mark.parametrize("as_json", [False, True])
@pytest.mark.parametrize("code", LOGGED.values(), ids=LOGGED)
def test_nothing_that_is_logged_steers_a_terminal(code: str, as_json: bool) -> None:
    lines = said(code, as_json=as_json)
    assert lines
    for line in lines:
        assert line.isprintable(), line
    assert "52;c;aGk=" in "".join(lines), "it is shown, not left out"


@pytest.mark.parametrize(("signals", "code"), [(1, 0), (2, -2)])
def test_the_first_signal_is_told_once_and_a_second_one_ends_at_once(
    signals: int, code: int
) -> None:
    script = """
import os, signal, sys, time
from schemas.runtime.process import stop_on_signals
with stop_on_signals(lambda: print("stopping", flush=True)) as stop:
    for _ in range(int(sys.argv[1])):
        os.kill(os.getpid(), signal.SIGINT)
        stop.wait(5)
        time.sleep(0.2)
print("stopped" if stop.is_set() else "not asked to")
"""
    ran = subprocess.run(
        [sys.executable, "-c", script, str(signals)], capture_output=True, text=True, timeout=60
    )
    assert ran.returncode == code
    assert ran.stdout.splitlines() == ["stopping", "stopped"][: 3 - signals]


def test_an_end_without_a_signal_tells_nothing() -> None:
    script = (
        "from schemas.runtime.process import stop_on_signals\n"
        "with stop_on_signals(lambda: print('stopping')): pass"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert (ran.returncode, ran.stdout) == (0, "")
