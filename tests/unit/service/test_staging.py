"""Raw records on their way to the ledger."""

import threading

from schemas.wire import sha256
from service.staging import Staging


def test_what_a_manifest_names_is_handed_out_by_digest() -> None:
    staging = Staging()
    staging.add(b"one")
    staging.add(b"two")
    assert staging.collect([sha256(b"two"), sha256(b"never seen")]) == {sha256(b"two"): b"two"}


def test_the_oldest_records_make_room_and_memory_stays_bounded() -> None:
    staging = Staging(most_bytes=10)
    for record in (b"1111", b"2222", b"3333"):
        staging.add(record)
    digests = [sha256(record) for record in (b"1111", b"2222", b"3333")]
    assert list(staging.collect(digests).values()) == [b"2222", b"3333"]


def test_the_same_record_twice_takes_its_room_once() -> None:
    staging = Staging(most_bytes=8)
    for record in (b"1111", b"2222", b"1111", b"2222", b"1111"):
        staging.add(record)
    assert len(staging.collect([sha256(b"1111"), sha256(b"2222")])) == 2


def test_what_is_on_disk_is_forgotten_and_its_room_is_free_again() -> None:
    staging = Staging(most_bytes=8)
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


def test_what_the_bus_lost_adds_up() -> None:
    staging = Staging()
    staging.on_miss(2)
    staging.on_miss(5)
    assert staging.missed == 7
