"""All checks by file: which part of the project each reference output proves."""

import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Final

from tests.golden import (
    contradiction,
    fusion,
    geometry,
    lidarcoda,
    losses,
    metrics,
    motion,
    networks,
)
from tests.golden.difference import Difference
from tests.golden.files import AbsentError, UnknownNameError

Check = Callable[[Path, Path], list[Difference]]
"""Takes the folder and one file in it; returns every comparison made."""

CHECKS: Final[Mapping[str, Check]] = {
    **geometry.CHECKS,
    **lidarcoda.CHECKS,
    **motion.CHECKS,
    **contradiction.CHECKS,
    **fusion.CHECKS,
    **losses.CHECKS,
    **metrics.CHECKS,
    **networks.CHECKS,
}
"""By pattern of the file's name in the folder."""


@dataclass(frozen=True, slots=True)
class Checked:
    """One file of the folder.

    Attributes:
        name: In the folder, with forward slashes.
        differences: Every comparison made; empty when not checked.
        problem: Why it was not checked, or why it cannot be; empty when it was.
        fails: Whether a comparison does not hold, or the file could not be read.
    """

    name: str
    differences: tuple[Difference, ...] = ()
    problem: str = ""
    fails: bool = False


def files_in(folder: Path) -> list[str]:
    """List every .npz file of a folder, sorted."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.npz"))


def check_of(name: str) -> Check | None:
    """Find the check of a file; None where no part claims it."""
    return next((check for pattern, check in CHECKS.items() if fnmatch(name, pattern)), None)


def check_file(folder: Path, name: str) -> Checked:
    """Run the check of one file; a damaged one fails, one of another form is not checked."""
    check = check_of(name)
    if check is None:
        return Checked(name, problem="no part claims it")
    try:
        differences = tuple(check(folder, folder / name))
    except (AbsentError, UnknownNameError) as error:
        return Checked(name, problem=f"needs {error}")
    except (OSError, EOFError, KeyError, IndexError, ValueError, zipfile.BadZipFile) as error:
        return Checked(name, problem=f"{type(error).__name__}: {error}", fails=True)
    if not differences:
        return Checked(name, problem="nothing was compared", fails=True)
    return Checked(name, differences, fails=not all(each.holds for each in differences))


def check_folder(folder: Path) -> Iterator[Checked]:
    """Run the checks of all files of a folder."""
    for name in files_in(folder):
        yield check_file(folder, name)
