"""Digests of source code, on a small package of the test's own."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from workers import sources

MINE = '''
"""Mines."""

from pydantic import Field

from thing.below import loops


def mine() -> float:
    """Return the sum."""
    from thing.lazy import HALF

    return loops.twice(HALF)
'''
LOOPS = '''
"""Loops."""

REACH_M = 2.0
"""How far they look, metres."""


def twice(value: float) -> float:
    return value * REACH_M  # metres
'''


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The package `thing`: `mine` imports `below.loops`, and `lazy` in a function."""
    folder = tmp_path / "thing"
    for name, text in {
        "__init__.py": "",
        "mine.py": MINE,
        "lazy.py": "HALF = 0.5\n",
        "other.py": "UNUSED = 1\n",
        "below/__init__.py": "",
        "below/loops.py": LOOPS,
    }.items():
        file = folder / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    for module in ("thing", "thing.below"):  # of the test before
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setattr(sources, "OURS", ("thing",))
    forget()
    yield folder
    forget()


def forget() -> None:
    """Forget what was read of files."""
    for cached in (sources.source_digest, sources.syntax_digest, sources._modules, sources._read):
        cached.cache_clear()


def digests() -> tuple[str, str]:
    """The digest of bytes and that of syntax, read from the files as they are now."""
    forget()
    return sources.source_digest("thing"), sources.syntax_digest("thing.mine")


def change(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def test_a_module_of_a_package_within_a_package_is_digested(package: Path) -> None:
    source, syntax = digests()
    change(package / "below" / "loops.py", "REACH_M = 2.0", "REACH_M = 3.0")
    after = digests()
    assert source != after[0]
    assert syntax != after[1]


def test_what_a_function_imports_is_digested_too(package: Path) -> None:
    _, syntax = digests()
    change(package / "lazy.py", "0.5", "0.25")
    assert digests()[1] != syntax


def test_a_module_that_is_not_imported_does_not_count(package: Path) -> None:
    source, syntax = digests()
    change(package / "other.py", "1", "2")
    after = digests()
    assert source != after[0]
    assert syntax == after[1]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"""Loops."""', '"""Compiled loops."""'),
        ('"""How far they look, metres."""', '"""Search radius, metres."""'),
        ("  # metres", "  # to the rim"),
        ("    return value * REACH_M", "\n    return (\n        value * REACH_M\n    )"),
    ],
    ids=["docstring", "note of a constant", "comment", "layout"],
)
def test_other_words_and_layout_are_the_same_syntax(package: Path, old: str, new: str) -> None:
    _, syntax = digests()
    change(package / "below" / "loops.py", old, new)
    assert digests()[1] == syntax


def test_the_description_of_a_field_does_not_count_and_its_bound_does(package: Path) -> None:
    file = package / "lazy.py"
    file.write_text("from pydantic import Field\nHALF = Field(0.5, ge=0, description='Half.')\n")
    _, syntax = digests()
    change(file, "Half.", "One half.")
    assert digests()[1] == syntax
    change(file, "ge=0", "ge=0.1")
    assert digests()[1] != syntax


def test_the_texts_of_a_part_do_not_count_and_its_name_does(package: Path) -> None:
    file = package / "lazy.py"
    file.write_text("from thing.other import Part\nROW = Part(name='a', text='Old.', source='b')\n")
    _, syntax = digests()
    change(file, "Old.", "New.")
    change(file, "source='b'", "source='c'")
    assert digests()[1] == syntax
    change(file, "name='a'", "name='d'")
    assert digests()[1] != syntax


def test_a_string_that_is_used_counts(package: Path) -> None:
    change(package / "lazy.py", "0.5", "len('ab', description='c')")
    _, syntax = digests()
    change(package / "lazy.py", "'c'", "'d'")
    assert digests()[1] != syntax


def test_a_root_that_does_not_exist_is_an_error(package: Path) -> None:
    with pytest.raises(ModuleNotFoundError, match=r"thing\.gone"):
        sources.sources("thing.gone")
