"""The built wheel in a clean virtual environment, with the installed packages that it asks for.

Nothing is downloaded: the files of each package of the wheel's requirements are linked from this
environment, and no others, so that an import of anything else fails as on a fresh machine.
"""

import subprocess
import sys
import venv
from collections.abc import Iterator
from importlib.metadata import Distribution, distribution
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]

CLEAN = {"PATH": "/usr/bin:/bin"}
"""Variables of every command: no tree on the path."""


class InstalledWheel:
    """An environment with the wheel.

    Attributes:
        counterpoint: The command.
        python: The interpreter.
    """

    def __init__(self, folder: Path, wheel: Path, *extras: str) -> None:
        """Make the environment.

        Args:
            folder: New folder of the environment.
            wheel: The wheel.
            extras: Extras of it whose requirements are there too.
        """
        venv.create(folder, with_pip=False, symlinks=True)
        self.python = folder / "bin" / "python"
        self.counterpoint = folder / "bin" / "counterpoint"
        (site,) = folder.glob("lib/python*/site-packages")
        for package in required("counterpoint", *extras):
            if package != "counterpoint":
                link_files(distribution(package), site)
        command = [sys.executable, "-m", "pip", "--python", str(self.python), "install", "--quiet"]
        run([*command, "--no-index", "--no-deps", "--no-compile", str(wheel)])

    def run(self, *arguments: str | Path, cwd: Path) -> str:
        """Run the interpreter with arguments; return what it prints."""
        return run([str(self.python), *map(str, arguments)], cwd=cwd)


def built_wheel(folder: Path) -> Path:
    """Build the wheel of a copy of the tree, as a release does."""
    tree = folder / "tree"
    tree.mkdir()
    archive = run(["git", "ls-files", "--cached", "--others", "--exclude-standard"], cwd=ROOT)
    for name in archive.splitlines():
        if name.split("/")[0] in ("schemas", "service", "workers") or "/" not in name:
            copy = tree / name
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes((ROOT / name).read_bytes())
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check"]
    run([*command, "--no-deps", "--no-build-isolation", "-w", str(folder), str(tree)])
    (wheel,) = folder.glob("counterpoint-*.whl")
    return wheel


def required(package: str, *extras: str) -> set[str]:
    """Return the names of a package and of all that it requires here."""
    found, waiting = set[str](), [(package, extras)]
    while waiting:
        name, wanted = waiting.pop()
        if name in found and not wanted:
            continue
        found.add(name)
        for line in distribution(name).requires or ():
            needed = Requirement(line)
            names = ("", *wanted)
            if needed.marker is None or any(needed.marker.evaluate({"extra": e}) for e in names):
                following = (needed.name.lower(), tuple(needed.extras))
                if following[0] not in found:
                    waiting.append(following)
    return found


def link_files(package: Distribution, site: Path) -> None:
    """Link the top folders and files of a package."""
    for top in tops_of(package):
        target = Path(str(package.locate_file(top)))
        link = site / top
        if target.exists() and not link.exists():
            link.symlink_to(target)


def tops_of(package: Distribution) -> Iterator[str]:
    """Yield the names in `site-packages` that belong to a package."""
    yield from sorted({file.parts[0] for file in package.files or ()} - {"..", "__pycache__"})


def run(command: list[str], cwd: Path | None = None) -> str:
    """Run a command from a folder, without the tree on the path; return what it prints."""
    done = subprocess.run(command, cwd=cwd, env=CLEAN, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
