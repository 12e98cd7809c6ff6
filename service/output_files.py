"""Output files of commands: written whole or not at all, and never over a foreign file.

A picture or a report that a command wrote contains a mark, and is replaced when made again. Any
other file is replaced with `--force` alone, and a device, a pipe or a folder never.
"""

import os
import tempfile
from pathlib import Path
from typing import Final

from PIL import Image, UnidentifiedImageError
from PIL.PngImagePlugin import PngInfo

from service.errors import UsageError

MARK: Final = "counterpoint"
"""Name of the writing software: in the text of a PNG, and as the generator of a page."""

PAGE_MARK: Final = f'<meta name="generator" content="{MARK}">'

JSON_MARK: Final = f'"generator": "{MARK}"'
"""Mark of a JSON file of a command, near its beginning, as `json.dumps` writes it."""

_HEAD_BYTES: Final = 4096


def need_writable(path: Path, *, option: str, force: bool, endings: tuple[str, ...] = ()) -> None:
    """Check an output path before the work begins, and make its folder.

    Args:
        path: The path.
        option: Name of the option that gave it, for the message.
        force: True to replace a foreign file.
        endings: Accepted endings of the name; any if empty.

    Raises:
        UsageError: If the path cannot be written, or is a file that no command wrote.
    """
    if endings and path.suffix.lower() not in endings:
        raise UsageError(f"{option} must name a {' or '.join(endings)} file, got {path}")
    try:
        target = path.resolve()
        if target.is_dir():
            raise UsageError(f"{option} must name a file, and this is a folder: {path}")
        if target.exists() and not target.is_file():
            raise UsageError(f"{option} must name a file, and this is a pipe or a device: {path}")
        if target.is_file() and not force and not _is_ours(target):
            raise UsageError(
                f"{option}: this file exists, and counterpoint did not write it: name another, or "
                f"replace it with --force ({path})"
            )
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: a link to itself
        raise _cannot_write(path, error, option=option) from error
    need_folder(target.parent, option=option)


def need_folder(path: Path, *, option: str) -> None:
    """Make a folder unless it exists, and refuse one that cannot be written.

    Raises:
        UsageError: If it is a file, cannot be made, or cannot be written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except FileExistsError:
        raise UsageError(f"{option} needs a folder, and this is a file: {path}") from None
    except (OSError, ValueError) as error:
        raise _cannot_write(path, error, option=option) from error


def save_picture(picture: Image.Image, path: Path, *, option: str, force: bool) -> None:
    """Write a PNG with the mark of its writer.

    Raises:
        UsageError: If it cannot be written, or is a file that no command wrote.
    """
    need_writable(path, option=option, force=force)
    mark = PngInfo()
    mark.add_text("Software", MARK)
    growing = _growing(path)
    try:
        picture.save(growing, format="PNG", pnginfo=mark)
        growing.replace(path.resolve())
    except OSError as error:
        raise _cannot_write(path, error, option=option) from error
    finally:
        growing.unlink(missing_ok=True)


def save_text(text: str, path: Path, *, option: str, force: bool) -> None:
    """Write a text as UTF-8.

    Raises:
        UsageError: If it cannot be written, or is a file that no command wrote.
    """
    need_writable(path, option=option, force=force)
    growing = _growing(path)
    try:
        growing.write_text(text, encoding="utf-8")
        growing.replace(path.resolve())
    except OSError as error:
        raise _cannot_write(path, error, option=option) from error
    finally:
        growing.unlink(missing_ok=True)


def _growing(path: Path) -> Path:
    """Return the temporary file next to the target, which is renamed when it is complete."""
    target = path.resolve()
    return target.with_name(f".{target.name[:200]}.{os.getpid()}.part")


def _is_ours(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if not head:
        return True  # as `touch` or `mktemp` leaves it: nothing is lost
    if PAGE_MARK.encode() in head or JSON_MARK.encode() in head:
        return True
    try:
        with Image.open(path, formats=["PNG"]) as picture:
            return bool(picture.info.get("Software") == MARK)
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return False


def _cannot_write(path: Path, error: Exception, *, option: str) -> UsageError:
    said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return UsageError(f"{option} cannot be written: {said} ({path})")
