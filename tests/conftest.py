"""Fixtures that every kind of test may use."""

import os
from pathlib import Path

import pytest

from tests.reference_folder import reference_folder


@pytest.fixture(scope="session")
def reference() -> Path:
    """Folder of real logs with truth; `COUNTERPOINT_REFERENCE`, else `shared` beside the project.

    In CI its absence is a failure, elsewhere the test is skipped and says so.
    """
    folder = reference_folder()
    if not (folder / "data" / "logs").is_dir():
        message = f"no reference logs in {folder}; set COUNTERPOINT_REFERENCE to their folder"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return folder
