"""A token is made, replaced without a gap, and revoked; the file counts at once."""

from pathlib import Path

import pytest

from schemas.runtime.tokens import TokenFile
from service.cli.main import main


@pytest.fixture
def tokens(tmp_path: Path) -> Path:
    return tmp_path / "tokens"


def made(tokens: Path, capsys: pytest.CaptureFixture[str], *flags: str) -> tuple[str, str]:
    """Return what `token` prints, and what it remarks, on one line."""
    assert main(["token", str(tokens), "--name", "anna", *flags]) == 0
    printed = capsys.readouterr()
    return printed.out.strip(), " ".join(printed.err.split())


def test_a_token_is_replaced_without_a_gap(
    tokens: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old, remarks = made(tokens, capsys, "--role", "operator")
    assert "kept nowhere else" in remarks
    assert "stay valid" not in remarks
    opens = TokenFile(tokens).person_of
    new, remarks = made(tokens, capsys, "--role", "operator")
    assert "1 older tokens of anna stay valid" in remarks
    assert f"counterpoint token {tokens} --name anna --revoke-older" in remarks
    assert opens(old)
    assert opens(new)
    _, remarks = made(tokens, capsys, "--revoke-older")
    assert "revoked: 1 tokens of anna; the newest stays valid" in remarks
    assert opens(old) is None
    assert opens(new)


def test_revoking_takes_out_all_tokens_of_the_name_and_no_line_of_another(
    tokens: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, _ = made(tokens, capsys)
    second, _ = made(tokens, capsys)
    assert main(["token", str(tokens), "--name", "ben"]) == 0
    ben = capsys.readouterr().out.strip()
    tokens.write_text(f"# anna is on leave\n{tokens.read_text()}")
    assert "revoked: 2 tokens of anna" in made(tokens, capsys, "--revoke")[1]
    opens = TokenFile(tokens).person_of
    assert [opens(first), opens(second)] == [None, None]
    assert opens(ben)
    assert tokens.read_text().startswith("# anna is on leave\n")


@pytest.mark.parametrize("flag", ["--revoke", "--revoke-older"])
def test_a_name_without_a_token_cannot_be_revoked(
    tokens: Path, capsys: pytest.CaptureFixture[str], flag: str
) -> None:
    made(tokens, capsys)
    assert main(["token", str(tokens), "--name", "ana", flag]) == 1
    assert "no token of the name 'ana'" in " ".join(capsys.readouterr().err.split())
    assert main(["token", f"{tokens}.away", "--name", "anna", flag]) == 1


def test_a_token_in_a_file_is_said_to_be_there(
    tokens: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    printed, remarks = made(tokens, capsys, "--out", str(tmp_path / "anna.token"))
    assert printed == ""
    assert "nowhere" not in remarks
    assert "anna.token has the token" in remarks
    assert TokenFile(tokens).person_of((tmp_path / "anna.token").read_text().strip())
