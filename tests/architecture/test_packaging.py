"""The packages are ours, and the files are rooms, not halls."""

from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("schemas", "service", "workers")


@pytest.mark.parametrize("name", PACKAGES)
def test_the_imported_package_is_the_one_in_this_repository(name: str) -> None:
    file = import_module(name).__file__
    assert file is not None
    assert Path(file).resolve() == ROOT / name / "__init__.py"


@pytest.mark.parametrize("package", PACKAGES)
def test_no_file_grows_over_four_hundred_lines(package: str) -> None:
    lengths = {
        str(path.relative_to(ROOT)): len(path.read_text().splitlines())
        for path in (ROOT / package).rglob("*.py")
    }
    assert lengths
    assert {path: n for path, n in lengths.items() if n > 400} == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_every_file_says_in_its_first_line_what_it_is_for(package: str) -> None:
    silent = [
        str(path.relative_to(ROOT))
        for path in (ROOT / package).rglob("*.py")
        if not path.read_text().lstrip().startswith('"""')
    ]
    assert silent == []
