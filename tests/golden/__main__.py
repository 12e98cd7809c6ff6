"""`python -m tests.golden DIR`: compares the project with a folder of reference outputs."""

import sys
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tests.golden.checks import Checked, check_folder, files_in

OK, FAILED, USAGE = 0, 1, 2


def main(arguments: list[str]) -> int:
    """Print every comparison; 0 if all hold, 1 if one fails, 2 if nothing can be compared."""
    folder = Path(arguments[0]) if len(arguments) == 1 else None
    if folder is None or not folder.is_dir() or not files_in(folder):
        sys.stderr.write("usage: python -m tests.golden DIR, a folder with .npz files in it\n")
        return USAGE
    table = Table(box=None, pad_edge=False)
    for heading in ("part", "file", "output"):
        table.add_column(heading, no_wrap=True)
    for heading in ("largest", "tolerance"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    checked = []
    for each in check_folder(folder):
        checked.append(each)
        _add(table, each)
    console = Console(width=200, highlight=False) if not sys.stdout.isatty() else Console()
    console.print(table)
    failed = [each.name for each in checked if each.fails]
    not_checked = sum(not each.differences and not each.fails for each in checked)
    console.print(
        f"\n{len(checked)} files: {len(checked) - not_checked - len(failed)} hold, "
        f"{len(failed)} fail, {not_checked} not checked"
    )
    return FAILED if failed else OK


def _add(table: Table, checked: Checked) -> None:
    """Lay one file out, a row for each comparison."""
    part, _, file = map(escape, checked.name.rpartition("/"))
    if not checked.differences:
        verdict = "FAILS" if checked.fails else "not checked"
        table.add_row(part, file, checked.problem, "", "", verdict)
    for each in checked.differences:
        verdict = "holds" if each.holds else "FAILS"
        numbers = (f"{each.largest:.4g}", f"{each.tolerance:.4g}")
        table.add_row(part, file, each.what, *numbers, verdict)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
