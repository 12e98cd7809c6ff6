"""A bucket of a real Ceph gateway, watched by its notifications instead of by listings."""

from pathlib import Path

import pytest

from tests.benchmark.watched_bucket import watched
from tests.integration.object_store import Ceph

pytestmark = [pytest.mark.integration, pytest.mark.timeout(600)]

OBJECTS, CHANGES = 500, 5


def test_what_ceph_tells_is_looked_up_and_nothing_is_listed(ceph: Ceph, tmp_path: Path) -> None:
    found = watched(ceph, tmp_path, objects=OBJECTS, changes=CHANGES)
    assert found["changes"] == 2 * CHANGES
    assert found["requests_for_changes"] <= 2 * CHANGES, "one look at each object, no listing"
