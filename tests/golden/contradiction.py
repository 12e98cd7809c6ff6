"""Checks of which points contradict, and their instances."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from tests.golden.difference import Difference

CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {}
