"""Packages of others that a test needs: in CI their absence is a failure, elsewhere a skip."""

import os
from importlib import import_module
from typing import Any, NoReturn

import pytest


def needed(module: str, where: str) -> Any:
    """Import a module; without it fail in CI, and elsewhere skip the test.

    Args:
        module: Its dotted name.
        where: What installs it, as a phrase after "needs": "the extra `rerun`".
    """
    if os.environ.get("CI"):
        return import_module(module)
    return pytest.importorskip(module, reason=f"needs {where}")


def need(what: str) -> NoReturn:
    """End a test that lacks something of its machine: in CI it fails, elsewhere it is skipped.

    Args:
        what: What it lacks, as a sentence.
    """
    if os.environ.get("CI"):
        pytest.fail(what)
    pytest.skip(what)
