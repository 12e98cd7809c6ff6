"""Each verb of the command is loaded from its own file, and the help lists all of them."""

import subprocess
import sys
from importlib import import_module

import pytest
import typer

from service.cli.main import main
from service.cli.verbs import FILES, files_of


def verbs_of(app: typer.Typer) -> tuple[str, ...]:
    group = typer.main.get_group(app)
    return tuple(group.commands)


@pytest.mark.parametrize("file", FILES)
def test_a_file_has_the_verbs_that_the_table_names(file: str) -> None:
    app = typer.Typer(callback=lambda: None)
    import_module(f"service.cli.{file}").add_to(app)
    assert verbs_of(app) == FILES[file]


def test_all_files_are_those_of_the_table_in_its_order() -> None:
    assert [each.__name__ for each in files_of(None)] == [f"service.cli.{file}" for file in FILES]


def test_the_help_lists_every_verb(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    lines = capsys.readouterr().out.partition("Commands:\n")[2].partition("\n\n")[0].splitlines()
    listed = [line.split()[0] for line in lines if line[2] != " "]
    assert sorted(listed) == sorted(verb for verbs in FILES.values() for verb in verbs)


def test_a_wrong_verb_is_answered_with_a_near_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scor"]) == 1
    assert "score" in capsys.readouterr().err


def test_a_log_is_inspected_without_the_database_or_the_networks() -> None:
    program = (
        "import sys; from service.cli.main import main; main(['inspect', '--help']); "
        "print(sorted({'sqlalchemy', 'torch'} & set(sys.modules)), file=sys.stderr)"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ended.stderr == "[]\n"
