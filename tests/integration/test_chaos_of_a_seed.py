"""Chaos of one seed for less than a minute: killed, frozen, cut off, and equal byte for byte."""

import pytest

from tests.chaos.parts import Parts
from tests.chaos.run import run_chaos
from tests.needed import need

pytestmark = [pytest.mark.integration, pytest.mark.timeout(1200)]


def test_a_system_of_two_services_comes_out_of_chaos_as_from_an_undisturbed_run() -> None:
    if absent := Parts().absent():
        need("; ".join(absent))
    report = run_chaos(seed=7, seconds=40.0)
    words = "\n".join(report.lines())
    assert report.problems == [], words
    assert report.killed.total() >= 25, words
    assert report.dealt["clock set"] >= 3, words
    assert report.terms >= 3, words
    assert report.scenes > 100, words
