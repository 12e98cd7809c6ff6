"""Locks of a session: the TLS files of this process, and Zenoh's own settings laid over ours.

Both sides prove who they are: a session without a certificate of the authority gets no link. The
name in a certificate is what the rules of access control know a process by.
"""

import datetime
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import zenoh

from schemas.errors import PermanentError
from schemas.runtime.named_file import read_named_file
from schemas.runtime.private_file import read_private
from schemas.transport.endpoints import LOCKED_PROTOCOLS, protocol_of

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

MAX_CONFIG_BYTES: Final = 4_000_000
"""Bytes of a file of Zenoh's settings; rules of a thousand workers have 1 MB."""

_TLS: Final = "transport/link/tls"

_FREE: Final = "metadata"
"""Setting of Zenoh with any content, which is set as a whole."""


@dataclass(frozen=True, slots=True)
class Locks:
    """Files by which a process proves who it is, and knows the others; paths, no secrets.

    Attributes:
        ca: Certificate of the authority; empty: this process has no locks.
        certificate: Certificate of this process.
        key: Its private key.
        zenoh_config: Settings of Zenoh, JSON5, laid over ours; empty: none.
    """

    ca: str = ""
    certificate: str = ""
    key: str = ""
    zenoh_config: str = ""

    @property
    def is_set(self) -> bool:
        """True if this process can prove who it is."""
        return bool(self.ca and self.certificate and self.key)

    @property
    def name(self) -> str:
        """Name of this process in its certificate; empty without one.

        Raises:
            PermanentError: If the certificate cannot be read.
        """
        return name_in(Path(self.certificate)) if self.is_set else ""


OPEN: Final = Locks()
"""No locks: for the loopback."""


def _certificate(path: Path) -> "Certificate":
    from cryptography import x509

    try:
        return x509.load_pem_x509_certificate(read_named_file(path))
    except OSError as error:
        raise PermanentError(f"cannot read the certificate: {error.strerror} ({path})") from None
    except ValueError:
        raise PermanentError(f"this file is no certificate in PEM form ({path})") from None


def days_left(path: Path) -> int:
    """Return for how many whole days a certificate is valid; negative: it has expired.

    Raises:
        PermanentError: If the file is no certificate.
    """
    left = _certificate(path).not_valid_after_utc - datetime.datetime.now(datetime.UTC)
    return left.days


def name_in(path: Path) -> str:
    """Return the name (CN) of a certificate.

    Raises:
        PermanentError: If the file is no certificate with a name.
    """
    from cryptography import x509

    certificate = _certificate(path)
    names = certificate.subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)
    if not names:
        raise PermanentError(f"this certificate has no name (CN): make another ({path})")
    return str(names[0].value)


def check_locks(locks: Locks, endpoints: tuple[str, ...]) -> None:
    """Refuse locks that are incomplete, cannot be read, or whose key others can read.

    Args:
        locks: The locks.
        endpoints: What is listened on or connected to.

    Raises:
        PermanentError: With what to mend.
    """
    files = {"tls_ca": locks.ca, "tls_certificate": locks.certificate, "tls_key": locks.key}
    missing = [setting for setting, path in files.items() if not path]
    if 0 < len(missing) < len(files):
        raise PermanentError(f"TLS needs three files: also set {' and '.join(missing)}")
    if not missing:
        for setting, path in files.items():
            if not Path(path).is_file():
                raise PermanentError(f"{setting}: there is no such file ({path})")
        read_private(Path(locks.key), what="tls_key")
    elif not locks.zenoh_config:
        for endpoint in endpoints:
            if protocol_of(endpoint) in LOCKED_PROTOCOLS and "#" not in endpoint:
                raise PermanentError(
                    f"{endpoint} needs certificates: set tls_ca, tls_certificate and tls_key; "
                    "`counterpoint certs DIR` makes them"
                )


def lay_locks(config: zenoh.Config, locks: Locks, *, listens: bool) -> None:
    """Write the locks into the configuration of a session, and the user's file over them.

    Args:
        config: Configuration of a session.
        locks: The locks, checked.
        listens: True for a router, whose sessions must all have a certificate.

    Raises:
        PermanentError: If the file of Zenoh's settings is none.
    """
    if locks.is_set:
        values: dict[str, Any] = {
            "root_ca_certificate": locks.ca,
            "connect_certificate": locks.certificate,
            "connect_private_key": locks.key,
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        }
        if listens:
            values |= {"listen_certificate": locks.certificate, "listen_private_key": locks.key}
        for key, value in values.items():
            config.insert_json5(f"{_TLS}/{key}", json.dumps(value))
    if locks.zenoh_config:
        path = Path(locks.zenoh_config)
        for key, value in leaves(read_zenoh_config(path)):
            try:
                config.insert_json5(key, json.dumps(value))
            except zenoh.ZError as error:
                reason = str(error).split(" at /", maxsplit=1)[0].strip()
                raise PermanentError(
                    f"zenoh_config: Zenoh refuses {key}: {reason} ({path})"
                ) from None


def read_zenoh_config(path: Path) -> dict[str, Any]:
    """Read a file of Zenoh's settings.

    Raises:
        PermanentError: If it cannot be read, or is no JSON5 object.
    """
    import json5  # slow, and few processes read such a file

    try:
        text = read_named_file(path, at_most=MAX_CONFIG_BYTES).decode("utf-8")
        try:
            content = json.loads(text)  # a thousand times faster
        except ValueError:
            content = json5.loads(text)
    except OSError as error:
        raise PermanentError(
            f"zenoh_config: cannot read the file: {error.strerror} ({path})"
        ) from None
    except (ValueError, RecursionError) as error:
        raise PermanentError(f"zenoh_config: the file is not JSON5: {error} ({path})") from None
    if not isinstance(content, dict):
        raise PermanentError(f"zenoh_config: the file must contain one object ({path})")
    return content


def leaves(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield path and value of each setting, so that one replaces ours and keeps its neighbours."""
    for name, value in content.items():
        if isinstance(value, dict) and value and name != _FREE:
            yield from leaves(value, f"{prefix}{name}/")
        else:
            yield f"{prefix}{name}", value
