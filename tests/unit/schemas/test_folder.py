"""A folder is listed past each odd entry, with the keys, sizes and etags that obstore gives."""

import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import obstore
import pytest
from obstore.store import LocalStore

from schemas.errors import BucketRefusedError, BucketUnreachableError
from schemas.transport.bucket import open_bucket
from schemas.transport.folder import Skipped, list_folder
from schemas.visible import has_controls, visible


def listed(folder: Path, prefix: str = "") -> tuple[list[str], dict[str, str]]:
    """Return the keys of a folder, and why each other entry is left out."""
    skipped: list[Skipped] = []
    keys = [found.key for found in open_bucket(str(folder)).list(prefix, on_skipped=skipped.append)]
    return keys, {each.name: each.why for each in skipped}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "car").mkdir()
    (tmp_path / "car" / "a.mcap").write_bytes(b"0123456789")
    return tmp_path


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        pytest.param(b"\xff\xfe.mcap", r"car/\xff\xfe.mcap", id="no UTF-8"),
        pytest.param(b"a\nb.mcap", r"car/a\nb.mcap", id="newline"),
        pytest.param(b"a\tb.mcap", r"car/a\tb.mcap", id="tab"),
        pytest.param(b"a\x1b[31mb.mcap", r"car/a\x1b[31mb.mcap", id="escape"),
        pytest.param(b"a\x7fb.mcap", r"car/a\x7fb.mcap", id="delete"),
        pytest.param("a\x9b31mb.mcap".encode(), r"car/a\x9b31mb.mcap", id="escape of one byte"),
        pytest.param("a\u202eb.mcap".encode(), r"car/a\u202eb.mcap", id="writing turned round"),
    ],
)
def test_a_name_that_no_terminal_should_see_is_skipped_and_named_escaped(
    folder: Path, name: bytes, shown: str
) -> None:
    Path(os.fsdecode(os.fsencode(folder) + b"/car/" + name)).write_bytes(b"x")
    keys, skipped = listed(folder)
    assert keys == ["car/a.mcap"]
    assert list(skipped) == [shown]
    assert not has_controls(shown)


def test_a_folder_with_a_control_character_in_its_name_is_skipped_with_all_in_it(
    folder: Path,
) -> None:
    (folder / "day\n1").mkdir()
    (folder / "day\n1" / "b.mcap").write_bytes(b"x")
    assert listed(folder) == (
        ["car/a.mcap"],
        {r"day\n1": "has a name that holds a control character"},
    )


def test_links_are_followed_but_not_round_in_a_loop(folder: Path) -> None:
    (folder / "car" / "back").symlink_to(folder)
    (folder / "car" / "itself").symlink_to("itself")
    (folder / "nothing.mcap").symlink_to("nowhere")
    (folder / "other").symlink_to("car")
    keys, skipped = listed(folder)
    assert keys == ["car/a.mcap", "other/a.mcap"]
    loop = "is a link in a loop of links"
    assert skipped == {
        "car/back": loop,
        "car/itself": loop,
        "other/back": loop,
        "other/itself": loop,
        "nothing.mcap": "is a broken link",
    }


def test_what_is_no_file_is_skipped_and_never_opened(folder: Path) -> None:
    os.mkfifo(folder / "pipe.mcap")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(folder / "s.mcap"))
        (folder / "null.mcap").symlink_to("/dev/null")
        keys, skipped = listed(folder)
    assert keys == ["car/a.mcap"]
    assert sorted(skipped) == ["null.mcap", "pipe.mcap", "s.mcap"]


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that another user can reach, unlike those that pytest makes."""
    with tempfile.TemporaryDirectory(prefix="open") as name:
        Path(name).chmod(0o755)
        (Path(name) / "a.mcap").write_bytes(b"x")
        yield Path(name)


LIST_AS_NOBODY = """
import os, sys
from pathlib import Path
from schemas.transport.folder import list_folder
os.setgroups([])
os.setgid(65534)
os.setuid(65534)
skipped = []
found = list_folder(Path(sys.argv[1]), "", skipped.append)
print([each.key for each in found], [(each.name, each.why, each.hides) for each in skipped])
"""


@pytest.mark.skipif(os.getuid() != 0, reason="only root may become another user")
@pytest.mark.parametrize("mode", [0o000, 0o004], ids=["closed", "seen but not entered"])
def test_a_folder_that_may_not_be_read_is_skipped(open_folder: Path, mode: int) -> None:
    (open_folder / "lost+found").mkdir()
    (open_folder / "lost+found" / "b.mcap").write_bytes(b"x")
    (open_folder / "lost+found").chmod(mode)
    said = subprocess.run(
        [sys.executable, "-c", LIST_AS_NOBODY, str(open_folder)],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    denied = ("lost+found", "may not be read", "lost+found")
    assert said.strip() == f"{['a.mcap']} {[denied]}"


def test_a_file_that_vanishes_during_the_listing_is_left_out(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scan of a folder hands out names in blocks: what is deleted meanwhile still comes."""
    for number in range(5):
        (folder / f"{number}.mcap").write_bytes(b"x")
    scandir = os.scandir

    class Scan:
        """The entries of a folder, of which one is deleted before it is looked at."""

        def __init__(self, path: str) -> None:
            with scandir(path) as entries:
                self._entries = list(entries)
            (folder / "3.mcap").unlink(missing_ok=True)

        def __enter__(self) -> Iterator[os.DirEntry[str]]:
            return iter(self._entries)

        def __exit__(self, *_: object) -> None:
            pass

    monkeypatch.setattr("os.scandir", Scan)
    skipped: list[Skipped] = []
    found = [entry.key for entry in list_folder(folder, "", skipped.append)]
    assert found == ["0.mcap", "1.mcap", "2.mcap", "4.mcap", "car/a.mcap"]
    assert skipped == []


ODD_BUT_USABLE = (
    *"~#?[]{}|^`<>\"\\*:@&=+$,;!'()% ",
    *("ü", "中文", "🚗", "a%2Fb", "%ff", ".hidden", "a#1#2", "a#1x", "#", "#7", "log#12", "log#"),
    *("a\u0301", "\ufffe", "\u0661#\u0661", "a" * 250),
)


def test_keys_sizes_and_etags_are_those_of_obstore(tmp_path: Path) -> None:
    """Else every log of an existing state would count as replaced, and be mined again."""
    for number, name in enumerate(ODD_BUT_USABLE):
        path = tmp_path / f"d{number % 3}#{number % 5}" / f"x{number % 2} y" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(number))
        changed_ns = (number - 3) * 1_234_567_890_123_457
        os.utime(path, ns=(changed_ns, changed_ns))
    (tmp_path / "link").symlink_to("d0#0")
    (tmp_path / "d1#1" / "l.mcap").symlink_to("/etc/hostname")
    bucket = open_bucket(str(tmp_path))
    for prefix in ("", "link", "d1#1/", "d1#1/x1 y", "d1", "nowhere", "link/x0 y/~"):
        for after in (None, "d1#1", "d1#1/x1 y/中文"):
            batches = obstore.list(LocalStore(tmp_path), prefix or None, offset=after)
            theirs = sorted(
                (str(each["path"]), each["size"], each["e_tag"])
                for batch in batches
                for each in batch
            )
            ours = [(each.key, each.size, each.etag) for each in bucket.list(prefix, after)]
            assert ours == theirs
    everything = list(bucket.list())
    assert len(everything) > len(ODD_BUT_USABLE)
    for entry in everything:
        assert bucket.head(entry.key) == entry


@pytest.mark.parametrize("prefix", ["../x", "a//b", "a/./b", "a\nb"])
def test_a_prefix_that_is_no_key_is_refused(folder: Path, prefix: str) -> None:
    with pytest.raises(BucketRefusedError):
        listed(folder, prefix)


def test_a_disk_that_fails_is_no_odd_entry(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What lies on it would count as deleted."""
    scandir = os.scandir

    def failing(path: str) -> object:
        if path.endswith("car"):
            raise OSError(5, "Input/output error", path)
        return scandir(path)

    monkeypatch.setattr("os.scandir", failing)
    with pytest.raises(BucketUnreachableError, match=r"Input/output error .*, car\)"):
        listed(folder)


def test_text_is_escaped_and_cut() -> None:
    assert visible("a\nb\x00\udcff\u2028ü", limit=100) == r"a\nb\x00\xff\u2028ü"
    assert visible("x" * 10, limit=10) == "x" * 10
    assert visible("x" * 11, limit=10) == "x" * 9 + "…"
    assert len(visible("\n" * 10_000, limit=10)) == 10
