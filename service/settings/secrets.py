"""Secrets in settings: accepted from a private file or a variable, and from nowhere else."""

import stat
from collections.abc import Mapping
from pathlib import Path

from service.settings.hidden_passwords import shown
from service.settings.sources import Written


def exposed_secrets(laid: Mapping[str, Written]) -> list[str]:
    """Return a sentence for each secret that other users of this machine can read.

    A flag is in the list of processes. A file may be readable by all.

    Args:
        laid: Written value of each setting.
    """
    problems = []
    for written in laid.values():
        if not isinstance(written.value, str) or shown(written.value) == written.value:
            continue
        if written.kind == "flag":
            problems.append(
                f"{written.where}: a password in a flag is in the list of processes: write it into "
                f"the settings file, or set the variable COUNTERPOINT_{written.setting.upper()}"
            )
        elif written.kind == "file" and _is_readable_by_all(Path(written.where)):
            problems.append(
                f"{written.where}: {written.setting} has a password, and every user of this "
                "machine can read the file: chmod o-r it"
            )
    return problems


def _is_readable_by_all(path: Path) -> bool:
    try:
        return bool(path.stat().st_mode & stat.S_IROTH)
    except OSError:
        return False
