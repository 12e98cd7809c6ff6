"""A few hundred odd messages and settings: each is taken, or refused in a sentence."""

from tests.fuzz.messages import decode_many
from tests.fuzz.settings import read_many


def test_every_message_of_the_bus_is_decoded_or_refused() -> None:
    found = decode_many(200, first_seed=1)
    assert found.failures == {}
    assert found.count >= 150
    assert {"request", "reply", "record", "lease", "announcement"} <= found.ends.keys()


def test_every_set_of_settings_is_accepted_or_refused() -> None:
    ends, failures = read_many(60, first_seed=1)
    assert failures == {}
    assert ends.total() >= 50
