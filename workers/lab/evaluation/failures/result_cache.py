"""Cache of mined logs on disk, so that a long benchmark can run in pieces."""

import hashlib
from functools import lru_cache
from pathlib import Path

from pydantic import ValidationError

from schemas.canonical import canonical_json
from schemas.mining import MiningSettings
from workers.lab.evaluation.failures.mine_log import LogJob
from workers.lab.evaluation.failures.rows import REVISION, MinedLog
from workers.lab.evaluation.failures.uncertainty import Probing
from workers.lab.simulation.faults.fault_truth import FILE as PLANTED
from workers.sources import syntax_digest
from workers.version import version_of


def load_mined_log(
    folder: Path | None, job: LogJob, settings: MiningSettings, probing: Probing
) -> MinedLog | None:
    """Read a cached log of the same code, settings and slips; None where there is none."""
    if folder is None:
        return None
    file = _file(folder, job, settings, probing)
    if not file.is_file():
        return None
    try:
        return MinedLog.model_validate_json(file.read_text())
    except ValidationError:  # of an earlier form, or cut off: it is mined again
        return None


def store_mined_log(
    folder: Path | None, job: LogJob, settings: MiningSettings, probing: Probing, log: MinedLog
) -> None:
    """Write a mined log to the cache, if a folder is given; the file is replaced atomically."""
    if folder is None:
        return
    file = _file(folder, job, settings, probing)
    file.parent.mkdir(parents=True, exist_ok=True)
    growing = file.with_suffix(".part")
    growing.write_text(log.model_dump_json())
    growing.replace(file)


def _file(folder: Path, job: LogJob, settings: MiningSettings, probing: Probing) -> Path:
    facts = {
        "revision": REVISION,
        "recording": job.recording.revision,
        "truth": _truth_digest(job.truth / job.recording.log_id),
        "pipeline": _version(settings.model_dump_json()),
        "slips": [str(slip) for slip in job.slips],
        **({} if job.variant is None else {"variant": str(job.variant), "labels": _labels()}),
        "probing": str(probing),
    }
    digest = hashlib.sha256(canonical_json(facts)).hexdigest()[:16]
    return folder / f"{job.recording.log_id.replace('/', '-')}-{digest}.json"


def _truth_digest(folder: Path) -> str:
    """Digest the truth of a log by file names, sizes and plan, without reading every point."""
    files = sorted(folder.glob("*"))
    names = "\n".join(f"{file.name} {file.stat().st_size}" for file in files)
    planted = folder / PLANTED
    text = planted.read_text() if planted.is_file() else ""
    return hashlib.sha256(f"{names}\n{text}".encode()).hexdigest()


@lru_cache(maxsize=1)
def _labels() -> str:
    """Digest the code that makes the labels of a variant, which no pipeline version covers."""
    return syntax_digest("workers.lab.evaluation.failures.planting")


@lru_cache(maxsize=4)
def _version(settings_json: str) -> str:
    return version_of(MiningSettings.model_validate_json(settings_json))
