"""The table of differences from the paper lists every part that has two forms."""

import re
from pathlib import Path

WORKERS = Path(__file__).resolve().parents[2] / "workers"
LINKED = set(re.findall(r"\]\(([^)#]+)\)", (WORKERS / "PAPER.md").read_text(encoding="utf-8")))
FORM_PARAMETER = re.compile(r"^    +form: Form = ", re.MULTILINE)


def test_every_part_with_two_forms_is_in_the_table() -> None:
    parts = {
        path.relative_to(WORKERS).as_posix()
        for path in WORKERS.rglob("*.py")
        if FORM_PARAMETER.search(path.read_text(encoding="utf-8"))
    }
    assert "lidar/range_image.py" in parts
    assert parts - LINKED == set()


def test_the_table_names_only_files_that_exist() -> None:
    assert [name for name in sorted(LINKED) if not (WORKERS / name).is_file()] == []
