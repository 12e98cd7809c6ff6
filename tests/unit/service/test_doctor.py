"""The doctor looks at the real thing, and says what to mend."""

import json
import os
import socket
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from threading import Event
from typing import Any

import pytest
import torch

from schemas.transport import keys
from schemas.transport.ask import ask_until
from schemas.transport.bus import client_session, router_session
from service.cli.main import main
from service.doctor import answers as doctor_answers
from service.doctor import machine as doctor_machine
from service.doctor import network as doctor_network
from service.doctor import stores as doctor_stores
from service.doctor.examination import examine
from service.doctor.finding import Finding
from service.security.authority import open_authority
from service.security.names import BUS_ROLES
from service.settings.config import Settings, load_settings, read_settings
from service.store.engine import DATABASE_NAME, open_store
from service.store.served_bucket import note_served
from service.store.state import StateLock
from tests.box_logs import OBJECTS, Put, boxes_at, clouds, stamp, write
from tests.box_messages import detections
from tests.contracts.ledger_world import World
from tests.free_ports import free_endpoint
from tests.tiny_logs import Recorder, drive


@pytest.fixture(autouse=True)
def _no_settings_from_outside(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in [name for name in os.environ if name.startswith("COUNTERPOINT_")]:
        monkeypatch.delenv(name)
    monkeypatch.chdir(tmp_path)


def settings(**flags: Any) -> Settings:
    given: dict[str, Any] = {"http_listen": "", "worker_http_listen": ""}
    return load_settings(**given | flags)


def told(findings: Iterator[Finding]) -> list[tuple[str, str]]:
    return [(finding.verdict, finding.says) for finding in findings]


def a_log() -> Path:
    log = Path("logs/car-7/today/drive.mcap")
    log.parent.mkdir(parents=True)
    log.write_bytes(Recorder().write(drive(1)))
    return log


def test_a_bucket_is_listed_and_read_and_nothing_is_written_to_it() -> None:
    log = a_log()
    before = sorted(Path("logs").rglob("*"))
    (_, lists), (verdict, reads) = told(doctor_stores.bucket(settings(bucket="logs")))
    assert lists.startswith("1 logs, ")
    assert (verdict, reads) == ("ok", "byte ranges can be read (car-7/today/drive.mcap)")
    assert sorted(Path("logs").rglob("*")) == before
    log.write_bytes(b"something else entirely")
    assert "does not begin like" in told(doctor_stores.bucket(settings(bucket="logs")))[1][1]


def test_entries_of_a_bucket_that_are_no_logs_are_named() -> None:
    a_log()
    Path("logs/notes.txt").write_text("x")
    first = told(doctor_stores.bucket(settings(bucket="logs")))[0]
    assert first == ("ok", "skipped: notes.txt is no .mcap file")
    Path("logs/loop").symlink_to("loop")
    verdict, says = told(doctor_stores.bucket(settings(bucket="logs")))[0]
    assert verdict == "warning"
    assert says == "skipped: loop is a link in a loop of links; notes.txt is no .mcap file"


def test_a_bucket_without_a_log_that_counts_is_a_warning() -> None:
    a_log()
    (finding,) = told(doctor_stores.bucket(settings(bucket="logs", include="bus-*")))
    assert finding == (
        "warning",
        "lists, but no .mcap log in it counts; include: bus-*, exclude: none",
    )


def test_what_a_recorded_answer_leaves_open_is_a_warning() -> None:
    Path("logs").mkdir()
    boxes = [
        Put(
            OBJECTS,
            stamp(number),
            detections(boxes_at(10.0), stamp_ns=stamp(number), frame_id="lidar"),
        )
        for number in range(20)
    ]
    Path("logs/drive.mcap").write_bytes(write([*clouds(), *boxes]))
    using = settings(bucket="logs", supervised="recorded")
    (finding,) = told(doctor_answers.answer(using))
    assert finding[0] == "warning"
    assert "boxes on /objects" in finding[1]
    assert "your model says no motion: parked or moving cannot be judged" in finding[1]
    assert told(doctor_answers.answer(settings(bucket="logs"))) == []


def test_artifacts_are_written_and_read_and_left_as_they_were() -> None:
    Path("overlays").mkdir()
    ((verdict, says),) = told(doctor_stores.artifacts(settings(artifacts="overlays")))
    assert verdict == "ok"
    assert says.startswith("can be written and read (file:///")
    assert list(Path("overlays").iterdir()) == []


def test_artifacts_in_the_log_bucket_are_a_problem() -> None:
    a_log()
    ((verdict, _),) = told(doctor_stores.artifacts(settings(artifacts="logs", bucket="./logs/")))
    assert verdict == "problem"


def test_a_state_that_does_not_exist_is_not_made() -> None:
    findings = told(doctor_stores.state(settings(state=Path("deep/state"))))
    assert findings[0] == ("ok", f"will be made ({Path('deep/state').absolute()})")
    assert not Path("deep").exists()


def test_a_state_that_cannot_be_written_is_a_problem() -> None:
    # Nobody can make files in /proc, not even root, for whom permissions mean nothing.
    ((verdict, says),) = told(doctor_stores.state(settings(state=Path("/proc/1"))))
    assert verdict == "problem"
    assert "fix its permissions" in says


def test_whoever_holds_the_state_is_named() -> None:
    with StateLock(Path.cwd(), endpoint="tcp/127.0.0.1:7447"):
        findings = told(doctor_stores.state(settings(state=Path.cwd())))
    assert findings[-1] == ("ok", "a service holds it, at tcp/127.0.0.1:7447")


def test_the_file_system_of_a_folder_is_that_of_the_innermost_mount(tmp_path: Path) -> None:
    mounts = tmp_path / "mountinfo"
    mounts.write_text(
        "22 1 0:20 / / rw - ext4 /dev/sda rw\n"
        f"23 22 0:21 / {tmp_path}/far\\040away rw,relatime shared:1 - nfs4 host:/x rw\n"
    )
    assert doctor_stores.file_system_of(tmp_path / "far away" / "state", mounts) == "nfs4"
    assert doctor_stores.file_system_of(tmp_path / "near", mounts) == "ext4"


def test_a_database_of_an_older_version_is_only_a_warning() -> None:
    open_store(Path.cwd()).close()
    here = settings(state=Path.cwd())
    assert told(doctor_stores.database(here))[0][0] == "ok"
    with closing(sqlite3.connect(DATABASE_NAME)) as connection, connection:
        connection.execute("DELETE FROM schema_version WHERE version > 1")
    ((verdict, says),) = told(doctor_stores.database(here))
    assert verdict == "warning"
    assert "bring it up to date" in says


def test_a_state_of_another_bucket_is_a_warning(tmp_path: Path) -> None:
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
    with closing(open_store(tmp_path)) as store, store.writing() as connection:
        note_served(connection, (tmp_path / "one").as_uri())
    its = settings(state=tmp_path, bucket=str(tmp_path / "one"))
    assert [verdict for verdict, _ in told(doctor_stores.database(its))] == ["ok"]
    another = settings(state=tmp_path, bucket=str(tmp_path / "other"))
    _, (verdict, says) = told(doctor_stores.database(another))
    assert verdict == "warning"
    assert says.startswith(f"belongs to {(tmp_path / 'one').as_uri()}: ")


def test_what_is_no_database_and_what_does_not_answer_are_problems() -> None:
    Path(DATABASE_NAME).write_bytes(b"no database at all, whatever its name says" * 100)
    read = read_settings(state=Path.cwd(), bucket="nowhere", connect="tcp/127.0.0.1:9")
    problems = {}
    for finding in examine(read):
        if finding.verdict == "problem":
            problems[finding.what] = finding.says
        if finding.what == "http":
            break
    assert "does not exist" in problems["bucket"]
    assert "not a database, or a damaged one" in problems["database"]
    assert "no router at tcp/127.0.0.1:9" in problems["router"]


def test_a_router_without_a_service_is_a_warning() -> None:
    endpoint = free_endpoint()
    with router_session([endpoint]), client_session([endpoint]):
        (router, (verdict, says)) = told(doctor_network.router(settings(connect=endpoint)))
    assert router == ("ok", f"answers at {endpoint}")
    assert verdict == "warning"
    assert "none answers under 'counterpoint'" in says


def test_a_service_that_does_not_know_the_question_is_an_older_one() -> None:
    endpoint = free_endpoint()
    hello = keys.control(root=keys.DEFAULT_ROOT, verb="hello")
    with (
        router_session([endpoint]),
        client_session([endpoint]) as old,
        old.declare_queryable(hello, lambda query: query.reply(hello, b"{}"), complete=True),
        client_session([endpoint]) as other,
    ):
        ask_until(other, hello, stop=Event(), patience_s=30)  # the router knows the queryable now
        _, (verdict, says), _ = told(doctor_network.router(settings(connect=endpoint)))
    assert verdict == "warning"
    assert "but is of an older version that does not report its own number, and this" in says


def test_a_port_that_is_taken_is_named_and_no_problem() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        listen = f"127.0.0.1:{taken.getsockname()[1]}"
        findings = told(doctor_network.http(settings(http_listen=listen)))
    assert findings[0][0] == "warning"
    assert findings[0][1].startswith(f"{listen} is taken, by a process that runs already it seems")
    assert findings[1] == ("ok", "worker_http_listen is empty: nothing is served")
    assert told(doctor_network.http(settings(http_listen=listen)))[0][0] == "ok"


@pytest.mark.parametrize("listen", ["here", "192.0.2.1:9464"])
def test_an_address_that_this_machine_does_not_have_is_a_problem(listen: str) -> None:
    verdict, says = told(doctor_network.http(settings(http_listen=listen)))[0]
    assert (verdict, says.partition(": ")[0]) == ("problem", f"cannot listen on {listen}")


def test_the_role_of_a_certificate_tells_which_pages_its_process_serves() -> None:
    authority = open_authority(Path("authority"))
    pages = {}
    for role in BUS_ROLES:
        certificate = str(authority.issue(role, role))
        its = load_settings(
            http_listen="127.0.0.1:0",
            worker_http_listen="127.0.0.1:0",
            review_listen="127.0.0.1:0",
            tls_ca="authority/ca.pem",
            tls_certificate=certificate,
            tls_key=f"authority/{role}.key",
        )
        pages[role] = [says.partition("(")[2] for _, says in told(doctor_network.http(its))]
    assert pages == {
        "router": [],
        "service": ["http_listen)", "worker_http_listen)"],
        "worker": ["worker_http_listen)"],
        "reader": ["review_listen)"],
        "operator": ["review_listen)"],
    }


def test_a_certificate_of_another_authority_than_tls_ca_is_a_problem() -> None:
    signed = open_authority(Path("ours")).issue("miner-a", "worker")
    open_authority(Path("theirs")).issue("miner-a", "worker")
    both = Path("ours/ca.pem").read_bytes() + Path("theirs/ca.pem").read_bytes()
    Path("both.pem").write_bytes(both)

    def said(ca: str) -> list[tuple[str, str]]:
        files = {"tls_ca": ca, "tls_certificate": str(signed), "tls_key": "ours/miner-a.key"}
        return told(doctor_network.locks(settings(**files)))

    for ca in ("ours/ca.pem", "both.pem"):
        assert [verdict for verdict, _ in said(ca)] == ["ok"]
    _, (verdict, says) = said("theirs/ca.pem")
    assert verdict == "problem"
    assert says == (
        "another authority than that of tls_ca has signed the certificate of miner-a: copy both "
        "from the same authority (theirs/ca.pem)"
    )


def test_more_workers_than_processors_are_a_warning() -> None:
    finding = next(doctor_machine.devices(settings(workers=256)))
    assert finding.verdict == "warning"
    assert next(doctor_machine.devices(settings(workers=1))).verdict == "ok"


def test_the_device_of_the_networks_is_named_and_a_missing_gpu_is_a_problem() -> None:
    assert "the networks run on" in told(doctor_machine.devices(settings()))[-1][1]
    verdict, says = told(doctor_machine.devices(settings(device="cuda")))[-1]
    if torch.cuda.is_available():
        assert (verdict, torch.cuda.get_device_name() in says) == ("ok", True)
    else:
        assert verdict == "problem"
        assert "set device to auto or cpu" in says


def test_a_clock_that_was_set_back_is_a_problem() -> None:
    here = settings(state=Path.cwd())
    with closing(open_store(Path.cwd())) as store:
        world = World.on(store)
        world.clock.now_s = time.clock_gettime(time.CLOCK_REALTIME)
        world.listed("drive")
        world.plan_all()
        assert world.commit_shard(world.mine_lease()).ok
        assert told(doctor_machine.clock(here))[0][0] == "ok"
        world.clock.now_s += 7200
        assert world.commit_shard(world.mine_lease()).ok
    ((verdict, says),) = told(doctor_machine.clock(here))
    assert verdict == "problem"
    assert "the clock was set back" in says


def test_without_the_extra_the_workers_part_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_machine, "NEEDED", ("no_such_module_of_ours",))
    ((verdict, says),) = told(doctor_machine.parts(settings()))
    assert verdict == "warning"
    assert "pip install 'counterpoint[workers]'" in says


def test_a_version_whose_workers_would_get_no_work_is_a_warning(tmp_path: Path) -> None:
    def said(**flags: Any) -> tuple[str, str]:
        here = settings(supervised="recorded", state=tmp_path, **flags)
        return told(doctor_machine.parts(here))[-1]

    verdict, ours = said()
    assert (verdict, len(ours)) == ("ok", 12)
    assert said(expected_versions=(ours,)) == ("ok", f"{ours}, which is expected")
    verdict, says = said(expected_versions=("another",))
    assert verdict == "warning"
    assert f'expected_versions = ["{ours}"]' in says
    away = {"connect": "tls/router.example:7447"}
    assert said(**away) == ("ok", ours), "an empty ledger takes the first version"
    with closing(open_store(tmp_path)) as store:
        world = World.on(store)
        world.listed("drive")
        world.claim(version="former")
    assert said(**away)[0] == "warning"
    assert said() == ("ok", ours), "on the loopback every version gets work"
    with closing(open_store(tmp_path)) as store:
        World.on(store).claim(version=ours)
    assert said(**away) == ("ok", ours)


def test_the_verb_ends_with_one_when_there_is_a_problem(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor_machine, "find_spec", lambda _: None)  # loading them takes seconds
    assert main(["doctor", "--bucket", "nowhere", "--json"]) == 1
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {row["what"] for row in rows} >= {"settings", "bucket", "state", "clock", "devices"}
    a_log()
    assert main(["doctor", "--bucket", "logs"]) == 0
    assert "problems: 0" in capsys.readouterr().err


def test_a_camera_that_cannot_be_read_is_said_under_camera_and_nowhere_else() -> None:
    read = read_settings(bucket="", camera="nowhere.json", http_listen="", worker_http_listen="")
    found = [(each.what, each.says) for each in examine(read) if "nowhere.json" in each.says]
    assert [what for what, _ in found] == ["camera"]


def test_config_and_doctor_take_the_flags_of_parts(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--preset", "paper", "--weights", "w", "--model", "m", "--json"]) == 0
    rows = {row["setting"]: row for row in map(json.loads, capsys.readouterr().out.splitlines())}
    assert (rows["weights"]["value"], rows["weights"]["origin"]) == ("w", "--weights")
    assert rows["selfsupervised"]["value"] == "paper"
    assert main(["doctor", "--preset", "paper", "--weights", "nowhere", "--json"]) == 1
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert any("no such folder" in each["says"] for each in found if each["what"] == "workers")
