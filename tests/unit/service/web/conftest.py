"""A review page of a state with the scenes of one log."""

import shutil
from pathlib import Path

import pytest

from tests.unit.service.mined_state import mined_state
from tests.unit.service.web.page import Page


@pytest.fixture(scope="session")
def mined_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("review") / "state"
    mined_state(folder)
    return folder


@pytest.fixture
def state(tmp_path: Path, mined_once: Path) -> Path:
    """A copy of a state, which a test may change."""
    return Path(shutil.copytree(mined_once, tmp_path / "state"))


@pytest.fixture
def page(state: Path) -> Page:
    return Page(state)
