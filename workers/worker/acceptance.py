"""Acceptance of a service's settings: which buckets, models and weights a worker may be sent to.

Any process that reaches the router can answer `hello`. On this machine such a process is trusted.
From another machine a worker reads, writes and loads only the places of its own settings, or places
inside them.
"""

from pathlib import Path, PurePosixPath
from typing import Final
from urllib.parse import unquote, urlsplit

from schemas.mining import MiningSettings
from schemas.runtime.real_path import real_path
from schemas.transport.endpoints import is_loopback
from workers.worker.config import WorkerConfig

_ASKED: Final = {
    "bucket": "read logs from",
    "artifacts": "write overlays to",
    "model": "load the model",
    "weights": "load weights from",
    "predictions": "read predictions from",
}


def refusal(asked: MiningSettings, config: WorkerConfig) -> str:
    """Return in one sentence which setting is not accepted; empty when all are.

    Args:
        asked: The settings of the service.
        config: Configuration of the worker, with its own settings.
    """
    if all(is_loopback(endpoint) for endpoint in config.connect):
        return ""
    for setting, verb in _ASKED.items():
        named, own = getattr(asked, setting), getattr(config.accepts, setting)
        if named and not (own and is_inside(named, own)):
            mine = f"{setting} = {own!r}" if own else f"{setting} is empty"
            return (
                f"the service at {', '.join(config.connect)} asks this worker to {verb} {named!r}, "
                f"but the worker's own setting {mine}; if this is right, set {setting} "
                f"(COUNTERPOINT_{setting.upper()}) for the worker as for the service"
            )
    return ""


def is_inside(named: str, own: str) -> bool:
    """Return True if a URL or path is another one, or is inside it.

    Args:
        named: The requested place; links of a local path are followed.
        own: The accepted place; not empty.
    """
    if named == own:
        return True
    (root, path), (own_root, own_path) = _place(named), _place(own)
    return root == own_root and ".." not in path.parts and path.is_relative_to(own_path)


def _place(url: str) -> tuple[str, PurePosixPath]:
    parts = urlsplit(url)
    if parts.scheme in ("", "file"):
        local = real_path(Path(unquote(parts.path) if parts.scheme else url))
        return "file", PurePosixPath(local)
    # a query can change the meaning of a URL: only the same one is the same place
    root = f"{parts.scheme}://{parts.netloc}?{parts.query}#{parts.fragment}"
    return root, PurePosixPath("/", unquote(parts.path).strip("/"))
