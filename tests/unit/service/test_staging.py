"""Raw records on their way to the ledger."""

import subprocess
import sys
import threading
import time

import pytest

from schemas.canonical import sha256
from service.api.staging import ENTRY_BYTES, MOST_PATIENT, Staging, held_bytes


def test_what_a_manifest_names_is_handed_out_by_digest() -> None:
    staging = Staging()
    staging.add(b"one")
    staging.add(b"two")
    assert staging.collect([sha256(b"two"), sha256(b"never seen")]) == {sha256(b"two"): b"two"}


def test_the_oldest_records_make_room_and_memory_stays_bounded() -> None:
    staging = Staging(most_bytes=2 * held_bytes(b"1111"))
    for record in (b"1111", b"2222", b"3333"):
        staging.add(record)
    digests = [sha256(record) for record in (b"1111", b"2222", b"3333")]
    assert list(staging.collect(digests).values()) == [b"2222", b"3333"]


def test_the_same_record_twice_takes_its_room_once() -> None:
    staging = Staging(most_bytes=2 * held_bytes(b"1111"))
    for record in (b"1111", b"2222", b"1111", b"2222", b"1111"):
        staging.add(record)
    assert len(staging.collect([sha256(b"1111"), sha256(b"2222")])) == 2


def test_what_is_on_disk_is_forgotten_and_its_room_is_free_again() -> None:
    staging = Staging(most_bytes=held_bytes(b"22222222"))
    staging.add(b"1111")
    staging.discard([sha256(b"1111"), sha256(b"never seen")])
    staging.add(b"22222222")
    assert staging.collect([sha256(b"1111"), sha256(b"22222222")]) == {
        sha256(b"22222222"): b"22222222"
    }


def test_a_commit_that_overtook_its_last_record_waits_for_it() -> None:
    staging = Staging()
    staging.add(b"first")
    late = threading.Timer(0.05, staging.add, [b"last"])
    late.start()
    found = staging.collect([sha256(b"first"), sha256(b"last")], patience_s=30.0)
    late.join()
    assert list(found.values()) == [b"first", b"last"]


def test_commits_whose_records_never_come_leave_threads_to_the_others() -> None:
    staging, over = Staging(), threading.Event()

    def wait() -> None:
        staging.collect([sha256(b"comes at the end")], patience_s=60.0)
        over.set()

    forged = [threading.Thread(target=wait) for _ in range(MOST_PATIENT)]
    for each in forged:
        each.start()
    began_s = time.monotonic()
    while staging.patient < MOST_PATIENT:
        assert time.monotonic() < began_s + 30.0
        time.sleep(0.001)
    assert staging.collect([sha256(b"never seen")], patience_s=60.0) == {}
    assert not over.is_set()
    staging.add(b"comes at the end")
    for each in forged:
        each.join()
    assert staging.patient == 0


def test_what_the_bus_lost_adds_up() -> None:
    staging = Staging()
    staging.on_miss(2)
    staging.on_miss(5)
    assert staging.missed == 7


@pytest.mark.parametrize("size", [8, 100, 1500, 16_000])
def test_what_is_counted_is_the_memory_that_is_held(size: int) -> None:
    script = f"""
from service.api.staging import Staging
def resident() -> int:
    return int(open("/proc/self/statm").read().split()[1]) * 4096
staging, before = Staging(), resident()
for number in range(2 * {64 * 2**20} // ({size} + {ENTRY_BYTES}) + 1):
    staging.add(number.to_bytes(8, "big") + bytes({size} - 8))
print(resident() - before, staging.waiting_bytes)
"""
    said = subprocess.run(
        [sys.executable, "-c", script], check=True, timeout=60, capture_output=True
    ).stdout.split()
    held, counted = int(said[0]), int(said[1])
    assert counted <= 64 * 2**20
    assert 0.75 * counted < held < 1.25 * counted
