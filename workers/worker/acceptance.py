"""What a worker accepts of the settings that a service names: whoever answers `hello` is believed.

Whoever reaches the router can answer. On this machine that is a process like ourselves; elsewhere a
worker reads, writes and loads only what its own settings name, or what lies in it.
"""

from ipaddress import ip_address
from pathlib import Path, PurePosixPath
from typing import Final
from urllib.parse import unquote, urlsplit

from schemas.mining import MiningSettings
from schemas.runtime.real_path import real_path
from workers.worker.config import WorkerConfig

_ASKED: Final = {
    "bucket": "read logs from",
    "artifacts": "write overlays to",
    "model": "load the model",
    "weights": "load weights from",
}
_LOCAL_PROTOCOLS: Final = ("unixsock-stream", "unixpipe")


def refusal(asked: MiningSettings, config: WorkerConfig) -> str:
    """Say in one sentence what of this is not accepted; empty: all of it is.

    Args:
        asked: What the service names.
        config: Of the worker, with its own settings.
    """
    if all(is_loopback(endpoint) for endpoint in config.connect):
        return ""
    for setting, verb in _ASKED.items():
        named, own = getattr(asked, setting), getattr(config.accepts, setting)
        if named and not (own and lies_in(named, own)):
            mine = f"{setting} = {own!r}" if own else f"{setting} is empty"
            return (
                f"the service at {', '.join(config.connect)} asks this worker to {verb} {named!r}, "
                f"but the worker's own setting {mine}; if this is right, set {setting} "
                f"(COUNTERPOINT_{setting.upper()}) for the worker as for the service"
            )
    return ""


def is_loopback(endpoint: str) -> bool:
    """Whether whoever listens there runs on this machine.

    Args:
        endpoint: Of a router, such as `tcp/127.0.0.1:7447`.
    """
    protocol, _, rest = endpoint.partition("/")
    if protocol in _LOCAL_PROTOCOLS:
        return True
    address = rest.split("#")[0].split("?")[0].rpartition(":")[0].strip("[]")
    if address == "localhost":
        return True
    try:
        return ip_address(address).is_loopback
    except ValueError:
        return False


def lies_in(named: str, own: str) -> bool:
    """Whether a URL or path is another one, or lies in it.

    Args:
        named: What is asked for; links of a local path are followed.
        own: What it must be or lie in; not empty.
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
    # A query can change what a URL means: only the same one is the same place.
    root = f"{parts.scheme}://{parts.netloc}?{parts.query}#{parts.fragment}"
    return root, PurePosixPath("/", unquote(parts.path).strip("/"))
