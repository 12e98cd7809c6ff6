"""Authority of one system: its own root, and the certificates that it signs."""

import datetime
import ipaddress
import re
from collections.abc import Iterable
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from schemas.errors import PermanentError
from schemas.runtime.private_file import read_private, write_private
from service.errors import UsageError
from service.security.names import BUS_ROLES, BusRole

CA_NAME: Final = "ca.pem"
CA_KEY_NAME: Final = "ca.key"
REVOKED_NAME: Final = "revoked.txt"
"""Files of an authority. Only the signing of certificates needs its key, on no other machine."""

CA_DAYS: Final = 3650
DAYS: Final = 365
"""Validity of the authority and of a certificate, days."""

CLOCK_SKEW: Final = datetime.timedelta(hours=1)
"""Time by which a clock of the system may be late at the first start."""

_HOST: Final = re.compile(r"[A-Za-z0-9_*]([A-Za-z0-9._-]{0,251}[A-Za-z0-9])?")

ALWAYS_HOSTS: Final = ("localhost", "127.0.0.1", "::1")


class Authority:
    """A folder with the root of one system, and the certificates that it signed."""

    def __init__(self, folder: Path, certificate: x509.Certificate) -> None:
        """Keep the folder and the root; use `open_authority`."""
        self.folder, self._root = folder, certificate

    def issue(
        self, name: str, role: BusRole, *, hosts: Iterable[str] = (), days: int = DAYS
    ) -> Path:
        """Make key and certificate, `NAME.key` and `NAME.pem`; replace those that are there.

        Args:
            name: Name of the process, by which rules know it.
            role: What it may do.
            hosts: Names and addresses under which others reach it; those of the certificate that
                is there are kept.
            days: Validity.

        Returns:
            Path of the certificate.

        Raises:
            UsageError: If the name was revoked, or is that of a certificate in another role.
            PermanentError: If the key of the authority cannot be read.
        """
        self.need_free(name, role)
        key = ec.generate_private_key(ec.SECP256R1())
        path = self._path(name)
        named = (*self._hosts_before(path), *hosts)
        certificate = self._sign(name, role, key.public_key(), hosts=named, days=days)
        write_private(self.folder / f"{name}.key", _key_bytes(key))
        path.write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
        return path

    def need_free(self, name: str, role: BusRole) -> None:
        """Refuse a name that was revoked, or that has another role.

        Raises:
            UsageError: If it is such a name.
        """
        if name in self.revoked():
            raise UsageError(
                f"the name {name!r} was revoked, and its old certificate would be valid again: "
                "take another name"
            )
        before = self._path(name)
        if before.exists() and role_of(_load(before)) != role:
            raise UsageError(
                f"{name!r} is the name of a {role_of(_load(before))}, and cannot be a {role} too"
            )

    def revoke(self, name: str) -> None:
        """Delete a certificate and its key, and never sign that name again.

        Raises:
            UsageError: If there is none of this name.
        """
        path = self._path(name)
        if not path.exists():
            raise UsageError(f"no certificate of the name {name!r} ({self.folder})")
        with (self.folder / REVOKED_NAME).open("a", encoding="utf-8") as file:
            file.write(f"{name}\n")
        path.unlink()
        (self.folder / f"{name}.key").unlink(missing_ok=True)

    def revoked(self) -> set[str]:
        """Return the names that were revoked."""
        path = self.folder / REVOKED_NAME
        return set(path.read_text(encoding="utf-8").split()) if path.exists() else set()

    def certificates(self) -> list[x509.Certificate]:
        """Return every certificate in the folder that this authority signed, by name."""
        found = [_load(path) for path in sorted(self.folder.glob("*.pem"))]
        return [each for each in found if self._signed(each) and role_of(each)]

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.pem"

    def _hosts_before(self, path: Path) -> tuple[str, ...]:
        before = _load(path) if path.exists() else None
        return hosts_of(before) if before and self._signed(before) else ()

    def _signed(self, certificate: x509.Certificate) -> bool:
        return certificate != self._root and _has_signed(self._root, certificate)

    def _sign(
        self,
        name: str,
        role: BusRole,
        public: ec.EllipticCurvePublicKey,
        *,
        hosts: Iterable[str],
        days: int,
    ) -> x509.Certificate:
        now = datetime.datetime.now(datetime.UTC)
        key = _load_key(self.folder / CA_KEY_NAME)
        until = min(now + datetime.timedelta(days=days), self._root.not_valid_after_utc)
        usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        names = dict.fromkeys((name, *ALWAYS_HOSTS, *hosts))
        builder = (
            x509.CertificateBuilder()
            .subject_name(_subject(name, role))
            .issuer_name(self._root.subject)
            .public_key(public)
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - CLOCK_SKEW)
            .not_valid_after(until)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
            .add_extension(
                x509.SubjectAlternativeName([_general_name(each) for each in names]),
                critical=False,
            )
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_public_key(key.public_key()),
                critical=False,
            )
        )
        return builder.sign(key, hashes.SHA256())


def hosts_of(certificate: x509.Certificate) -> tuple[str, ...]:
    """Return the names and addresses under which others reach the holder of a certificate."""
    found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    addresses = found.get_values_for_type(x509.IPAddress)
    return (*found.get_values_for_type(x509.DNSName), *map(str, addresses))


def open_authority(folder: Path, *, system: str = "counterpoint") -> Authority:
    """Open the authority of a folder; make it if there is none.

    Args:
        folder: The folder; made, for its owner alone, if it is missing.
        system: Name of the root of a new authority.

    Raises:
        UsageError: If the folder has a key and no root, or the reverse.
        PermanentError: If the root cannot be read.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    root, key = folder / CA_NAME, folder / CA_KEY_NAME
    if not root.exists() and not key.exists():
        _make_root(folder, system)
    if not root.exists():
        raise UsageError(f"the authority is half there: {CA_NAME} is missing ({folder})")
    return Authority(folder, _load(root))


def role_of(certificate: x509.Certificate) -> str:
    """Return the role of a certificate; empty: it has none of ours."""
    units = certificate.subject.get_attributes_for_oid(NameOID.ORGANIZATIONAL_UNIT_NAME)
    role = str(units[0].value) if units else ""
    return role if role in BUS_ROLES else ""


def role_in(path: Path) -> str:
    """Return the role of the certificate in a file; empty: it has none of ours.

    Raises:
        PermanentError: If the file is no certificate.
    """
    return role_of(_load(path))


def is_signed_by(certificate: Path, ca: Path) -> bool:
    """Return true if an authority signed a certificate, itself or by the chain in its file.

    Args:
        certificate: File of the certificate, and of its chain if it has one.
        ca: File of the authority; it may name several.

    Raises:
        PermanentError: If one of the files has no certificate.
    """
    links, roots = _load_all(certificate), _load_all(ca)
    joined = takewhile(lambda pair: _has_signed(pair[1], pair[0]), pairwise(links))
    whole = [links[0], *(issuer for _, issuer in joined)]
    return any(_has_signed(root, link) for link in whole for root in roots)


def _has_signed(issuer: x509.Certificate, certificate: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def certificate_name(certificate: x509.Certificate) -> str:
    """Return the name of a certificate."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def _make_root(folder: Path, system: str) -> None:
    now = datetime.datetime.now(datetime.UTC)
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"{system} authority")])
    root = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_SKEW)
        .not_valid_after(now + datetime.timedelta(days=CA_DAYS))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    write_private(folder / CA_KEY_NAME, _key_bytes(key))
    (folder / CA_NAME).write_bytes(root.public_bytes(serialization.Encoding.PEM))


def _subject(name: str, role: BusRole) -> x509.Name:
    return x509.Name(
        [
            x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, role),
            x509.NameAttribute(NameOID.COMMON_NAME, name),
        ]
    )


def _usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        key_cert_sign=signs,
        crl_sign=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    if not _HOST.fullmatch(host):
        raise UsageError(f"not a name or address of a machine: {host!r}")
    return x509.DNSName(host)


def _key_bytes(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _load(path: Path) -> x509.Certificate:
    return _load_all(path)[0]


def _load_all(path: Path) -> list[x509.Certificate]:
    try:
        return x509.load_pem_x509_certificates(path.read_bytes())
    except OSError as error:
        raise PermanentError(f"cannot read the certificate: {error.strerror} ({path})") from None
    except ValueError:
        raise PermanentError(f"this file is no certificate in PEM form ({path})") from None


def _load_key(path: Path) -> ec.EllipticCurvePrivateKey:
    content = read_private(path, what="key of the authority")
    try:
        key = serialization.load_pem_private_key(content, password=None)
    except (ValueError, TypeError):
        raise PermanentError(f"this file is no private key without a password ({path})") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise PermanentError(f"the key of the authority is not of an elliptic curve ({path})")
    return key
