"""Parts of a system of chaos that a run may have or lack."""

from dataclasses import dataclass
from importlib.util import find_spec
from typing import Final, Literal

from tests.integration.object_store import PACKAGES, missing_programs
from tests.integration.steered_clock import compiler
from tests.reference_folder import reference_folder

PoolKind = Literal["quick", "local", "ray"]

SERVERS: Final = reference_folder() / "servers"
"""Folder of the script that starts the S3 store."""


@dataclass(frozen=True, slots=True)
class Parts:
    """Parts of a system in addition to services, routers and PostgreSQL.

    Attributes:
        clocks: True if each process has a system clock of its own, which is wrong and is set.
        gateway: True if logs and overlays lie behind an S3 gateway; else in folders.
        pool: Who mines: miners that make up their records, or workers that mine simulated streets
            in processes of a local pool or as actors of Ray.
    """

    clocks: bool = True
    gateway: bool = False
    pool: PoolKind = "quick"

    def __post_init__(self) -> None:
        assert self.pool != "quick" or not self.gateway, "quick miners read no bucket"

    def __str__(self) -> str:
        """Name them for a person."""
        clocks = "wrong clocks" if self.clocks else "right clocks"
        return f"{clocks}, {'S3 gateway' if self.gateway else 'folder'}, pool {self.pool}"

    def absent(self) -> list[str]:
        """Return a sentence for each part that this machine cannot run."""
        found = []
        if self.clocks and compiler() is None:
            found.append("wrong clocks need a C compiler: apt-get install -y gcc")
        if self.gateway and (missing := missing_programs()):
            install = f"apt-get install -y --no-install-recommends {PACKAGES}"
            found.append(f"the S3 gateway needs {', '.join(missing)}: {install}")
        if self.gateway and not (SERVERS / "ceph-up.sh").exists():
            found.append(f"the S3 gateway needs {SERVERS}/ceph-up.sh: set COUNTERPOINT_REFERENCE")
        if self.pool == "ray" and find_spec("ray") is None:
            found.append("the pool of Ray needs the extra `ray`")
        return found
