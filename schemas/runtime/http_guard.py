"""Lock of HTTP pages: TLS, and the token of a request."""

import base64
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from schemas.errors import PermanentError
from schemas.runtime.private_file import need_private
from schemas.runtime.tokens import Person, TokenFile

OPEN_PATHS: Final = frozenset({"/healthz", "/readyz"})
"""Pages of probes, which have no token: they state that a process lives, and no more."""

CHALLENGE: Final = 'Bearer realm="counterpoint", Basic realm="counterpoint", charset="UTF-8"'
"""Header of a refusal; a browser asks for name and password, and the password is the token."""

NEEDS_TOKEN: Final = "this page needs a token: `Authorization: Bearer TOKEN`"  # noqa: S105


@dataclass(frozen=True, slots=True)
class PageGuard:
    """Lock of the pages of a daemon.

    Attributes:
        tls: Context of the server; None: plain HTTP.
        tokens: Tokens that open the pages; None: no page needs one.
    """

    tls: ssl.SSLContext | None = None
    tokens: TokenFile | None = None

    def admits(self, path: str, headers: Mapping[str, str]) -> bool:
        """Return true if a request may be answered.

        Args:
            path: Path of the request.
            headers: By name in lower case.
        """
        if self.tokens is None or path in OPEN_PATHS:
            return True
        return self.person_of(headers) is not None

    def person_of(self, headers: Mapping[str, str]) -> Person | None:
        """Return whose token a request has; None: it has none that is known."""
        token = token_in(headers.get("authorization", ""))
        return self.tokens.person_of(token) if self.tokens is not None and token else None


def token_in(authorization: str) -> str:
    """Return the token of an `Authorization` header: of Bearer, or the password of Basic."""
    scheme, _, value = authorization.strip().partition(" ")
    if scheme.lower() == "bearer":
        return value.strip()
    if scheme.lower() == "basic":
        try:
            return base64.b64decode(value.strip(), validate=True).decode().partition(":")[2]
        except ValueError:
            return ""
    return ""


def tls_context(certificate: str, key: str) -> ssl.SSLContext:
    """Return the TLS context of a server: version 1.2 or later.

    Raises:
        PermanentError: If a file is missing, the two do not belong together, or every user can
            read the key.
    """
    for setting, path in (("http_certificate", certificate), ("http_key", key)):
        if not path:
            raise PermanentError(f"TLS of the pages needs two files: also set {setting}")
    need_private(Path(key), what="http_key")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(certificate, key)
    except OSError as error:  # an error of TLS is one too
        reason = error.strerror or "not a certificate and its key"
        raise PermanentError(
            f"http_certificate, http_key: cannot be used: {reason} ({certificate}, {key})"
        ) from None
    return context
