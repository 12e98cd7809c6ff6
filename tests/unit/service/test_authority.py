"""A renewed certificate is reached under the names of the one before."""

from pathlib import Path

import pytest
from cryptography import x509

from service.cli.main import main
from service.security.authority import hosts_of, is_signed_by, open_authority

ALWAYS = {"router", "localhost", "127.0.0.1", "::1"}


def hosts(folder: Path) -> set[str]:
    pem = (folder / "router.pem").read_bytes()
    return set(hosts_of(x509.load_pem_x509_certificate(pem)))


def renewed(folder: Path, *flags: str) -> set[str]:
    before = (folder / "router.pem").read_bytes() if folder.exists() else b""
    assert main(["certs", str(folder), "--router", "router", *flags]) == 0
    assert (folder / "router.pem").read_bytes() != before
    return hosts(folder)


def test_a_renewed_certificate_keeps_its_hosts_and_takes_further_ones(tmp_path: Path) -> None:
    folder = tmp_path / "authority"
    first = renewed(folder, "--host", "router.fleet.lan", "--host", "10.0.0.7", "--host", "fd00::7")
    assert first == ALWAYS | {"router.fleet.lan", "10.0.0.7", "fd00::7"}
    assert renewed(folder) == first
    assert renewed(folder, "--host", "10.0.0.8", "--host", "10.0.0.7") == first | {"10.0.0.8"}


def test_a_new_name_needs_the_rules_again_and_a_renewed_one_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def said(*flags: str) -> str:
        assert main(["certs", str(tmp_path / "authority"), *flags]) == 0
        return " ".join(capsys.readouterr().err.split())

    needs = "write the rules again with `acl`, and restart the routers"
    assert f"no rule knows router, miner-a yet: {needs}" in said(
        "--router", "router", "--worker", "miner-a"
    )
    assert f"no rule knows miner-b yet: {needs}" in said("--worker", "miner-a", "--worker=miner-b")
    assert needs not in said("--worker", "miner-b")
    assert needs not in said("--worker", "miner-b", "--only-missing")
    assert needs not in said()


def test_a_certificate_of_another_authority_lends_no_hosts(tmp_path: Path) -> None:
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    renewed(theirs, "--host", "elsewhere.example")
    assert renewed(ours) == ALWAYS
    (ours / "router.pem").write_bytes((theirs / "router.pem").read_bytes())
    assert renewed(ours) == ALWAYS


def test_a_certificate_is_signed_by_its_authority_or_through_the_chain_in_its_file(
    tmp_path: Path,
) -> None:
    signed = open_authority(tmp_path / "ours").issue("service", "service")
    theirs = open_authority(tmp_path / "theirs").issue("service", "service")
    ours = tmp_path / "ours" / "ca.pem"
    assert is_signed_by(signed, ours)
    assert not is_signed_by(theirs, ours)
    chain = tmp_path / "chain.pem"
    chain.write_bytes(signed.read_bytes() + ours.read_bytes())
    assert is_signed_by(chain, ours)
    chain.write_bytes(theirs.read_bytes() + signed.read_bytes())
    assert not is_signed_by(chain, ours), "a certificate that only lies next to it signs nothing"
