"""Exports in the background: one after another, counted, stopped, and honest about their end."""

import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from service.errors import NothingFoundError, UsageError
from service.export.jobs import MOST_WAITING, ExportJob, ExportJobs, JobState, folder_name
from tests.integration.running import until

PROGRAM = """
import json, sys, time
from pathlib import Path
name, folder = sys.argv[-1], Path(sys.argv[sys.argv.index("--state") + 1])
(folder / f"{name}.begun").touch()
if name == "waits":
    while not (folder / "go").exists():
        time.sleep(0.01)
for number in range(3):
    print(json.dumps({"scene_id": f"s{number}"}), flush=True)
told = "error: \\x1b[31mthe bucket is gone" if name == "fails" else "3 scenes written"
print(told, file=sys.stderr)
sys.exit({"fails": 1, "partly": 3}.get(name, 0))
"""


@pytest.fixture
def jobs(tmp_path: Path) -> Iterator[ExportJobs]:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    options, hidden = {"state": str(tmp_path)}, {"database": "postgresql://u:secret@h/n"}
    made = ExportJobs(
        f"{tmp_path}/out/",
        program=(sys.executable, "-S", str(program)),
        options=options,
        hidden=hidden,
    )
    with closing(made):
        yield made


def ended(jobs: ExportJobs, number: int) -> ExportJob:
    def now() -> ExportJob:
        return next(each for each in jobs.jobs() if each.number == number)

    until(lambda: not now().is_open, "the export ends")
    return now()


@pytest.mark.parametrize(
    ("name", "state", "text"),
    [
        ("week", JobState.DONE, "3 scenes written"),
        ("partly", JobState.INCOMPLETE, "3 scenes written"),
        ("fails", JobState.FAILED, "\\x1b[31mthe bucket is gone"),
    ],
)
def test_an_export_is_counted_and_its_end_is_told(
    jobs: ExportJobs, name: str, state: JobState, text: str
) -> None:
    job = ended(jobs, jobs.start(name, "json", scenes=3).number)
    assert (job.state, job.done, job.text) == (state, 3, text)


def test_exports_wait_for_each_other_and_the_same_one_is_started_once(
    jobs: ExportJobs, tmp_path: Path
) -> None:
    first = jobs.start("waits", "json", scenes=3)
    second = jobs.start("week", "json", scenes=3)
    assert jobs.start("waits", "json", scenes=3).number == first.number
    until(lambda: (tmp_path / "waits.begun").exists(), "the first one runs")
    assert not (tmp_path / "week.begun").exists()
    assert [job.state for job in jobs.jobs()] == [JobState.WAITING, JobState.RUNNING]
    (tmp_path / "go").touch()
    assert ended(jobs, second.number).state is JobState.DONE
    assert [job.number for job in jobs.jobs("waits")] == [first.number]
    assert jobs.start("waits", "json", scenes=3).number == second.number + 1, "it may go on"


def test_a_stopped_export_ends_and_one_that_waits_is_never_started(
    jobs: ExportJobs, tmp_path: Path
) -> None:
    first, second = (jobs.start(name, "json", scenes=3) for name in ("waits", "week"))
    until(lambda: (tmp_path / "waits.begun").exists(), "the first one runs")
    jobs.stop(second.number)
    jobs.stop(first.number)
    until(lambda: not [each for each in threading.enumerate() if each.name == "exports"], "it ends")
    assert {job.state for job in jobs.jobs()} == {JobState.STOPPED}
    assert not (tmp_path / "week.begun").exists()
    with pytest.raises(NothingFoundError, match="no export of the number 9"):
        jobs.stop(9)


def test_the_command_is_the_one_a_person_runs_without_secrets(
    jobs: ExportJobs, tmp_path: Path
) -> None:
    shown = jobs.command("it's", "mcap", bucket="s3://fleet")
    assert shown.startswith(f"counterpoint export --format mcap --out {tmp_path}/out/it-s-")
    assert shown.endswith(f"--state {tmp_path} --bucket s3://fleet -- 'it'\"'\"'s'")
    assert "secret" not in shown


def test_what_cannot_be_exported_is_refused_before_a_process_starts(jobs: ExportJobs) -> None:
    with pytest.raises(UsageError, match="no format 'csv'"):
        jobs.start("week", "csv", scenes=3)
    with pytest.raises(UsageError, match="semantickitti reads the logs"):
        jobs.start("week", "semantickitti", scenes=3)
    jobs.start("waits", "json", scenes=3)
    for number in range(MOST_WAITING + 2):
        try:
            jobs.start(f"week-{number}", "json", scenes=3)
        except UsageError as error:
            assert str(error).startswith(f"{MOST_WAITING} exports wait already")  # noqa: PT017
            return
    pytest.fail("jobs are not bounded")


def test_a_program_that_is_gone_is_named(tmp_path: Path) -> None:
    made = ExportJobs(str(tmp_path), program=("/no/such/program",), options={})
    with closing(made):
        job = ended(made, made.start("week", "json", scenes=1).number)
    assert job.state is JobState.FAILED
    assert job.text == "the command did not start: No such file or directory"


def test_folders_of_selections_are_plain_names_and_never_shared() -> None:
    assert folder_name("week-47") == "week-47"
    odd = ("../../etc", "a/b", "a b", ".", "..", "é", "n" * 300, "x\x1b[2J")
    names = [folder_name(each) for each in odd]
    assert len(set(names)) == len(odd)
    assert all("/" not in each and "." not in each and len(each) < 100 for each in names)
