"""Verbs on locks: `certs`, `acl`, `token`, `audit`, `sbom`."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Final

import typer

from schemas.bounds import MAX_INTEGER
from schemas.runtime.tokens import ROLES, is_role, new_token, token_line
from service.cli.options import Config, Connect, Database, Json, StateToRead, settings_for
from service.cli.output import json_line, page, remark, result_line, table
from service.cli.scenes import reader
from service.curation.audit import MAX_AUDIT_ASKED, AuditRequest, AuditRow
from service.errors import UsageError

SOON_DAYS: Final = 30
"""Rest of a validity, days, from which a certificate should be renewed."""


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    app.command(
        epilog="counterpoint certs authority --router router --service service --worker miner-a"
    )(certs)
    app.command(epilog="counterpoint acl authority --out authority/rules.json")(acl)
    app.command(epilog="counterpoint token tokens --name anna --role reviewer")(token)
    app.command(epilog="counterpoint audit --state counterpoint-state")(audit)
    app.command(epilog="counterpoint sbom > counterpoint.cdx.json")(sbom)


def certs(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the authority.")],
    router: Annotated[
        list[str] | None, typer.Option("--router", help="Name of a router. Repeatable.")
    ] = None,
    service: Annotated[
        list[str] | None, typer.Option("--service", help="Name of a service. Repeatable.")
    ] = None,
    worker: Annotated[
        list[str] | None, typer.Option("--worker", help="Name of a pool of workers. Repeatable.")
    ] = None,
    reader: Annotated[
        list[str] | None, typer.Option("--reader", help="Name of a reader. Repeatable.")
    ] = None,
    operator: Annotated[
        list[str] | None, typer.Option("--operator", help="Name of an operator. Repeatable.")
    ] = None,
    host: Annotated[
        list[str] | None,
        typer.Option("--host", help="Further name or address of these machines. Repeatable."),
    ] = None,
    revoke: Annotated[
        list[str] | None, typer.Option("--revoke", help="Name to lock out for good. Repeatable.")
    ] = None,
    days: Annotated[int, typer.Option("--days", min=1, max=3650, help="Validity.")] = 365,
    only_missing: Annotated[
        bool, typer.Option("--only-missing", help="Keep certificates that are valid for 30 days.")
    ] = False,
    json: Json = False,
) -> None:
    """Make an authority and certificates, renew or revoke them, and list them.

    Each NAME gets NAME.key and NAME.pem; a name that is there is renewed, with the hosts that it
    had, and its old certificate stays valid until it expires. Without a name the certificates are
    listed.
    """
    from service.output_files import need_folder
    from service.security.authority import certificate_name, open_authority, role_of
    from service.security.names import need_name

    wanted = {
        "router": router,
        "service": service,
        "worker": worker,
        "reader": reader,
        "operator": operator,
    }
    named = [(need_name(name), role) for role, names in wanted.items() for name in names or ()]
    if not named and not (folder / "ca.pem").exists():
        raise UsageError(
            f"no authority here: name what to make, such as --router router ({folder})"
        )
    need_folder(folder, option="DIR")
    authority = open_authority(folder)
    for name, role in named:
        authority.need_free(name, role)  # type: ignore[arg-type]
    for name in revoke or ():
        authority.revoke(name)
        remark(f"revoked: {name}; write the rules again with `acl`, and restart the routers")
    now = datetime.now(UTC)
    left = {
        certificate_name(each): (each.not_valid_after_utc - now).days
        for each in authority.certificates()
    }
    for name, role in named:
        if only_missing and left.get(name, 0) >= SOON_DAYS:
            continue
        path = authority.issue(name, role, hosts=host or (), days=days)  # type: ignore[arg-type]
        remark(f"certificate of {role} {name}: {path}")
    if new := [name for name, _ in named if name not in left]:
        remark(
            f"no rule knows {', '.join(new)} yet: write the rules again with `acl`, and restart "
            "the routers"
        )
    rows = [
        {
            "name": certificate_name(each),
            "role": role_of(each),
            "until": each.not_valid_after_utc.strftime("%Y-%m-%d"),
            "days_left": (each.not_valid_after_utc - now).days,
        }
        for each in authority.certificates()
    ]
    if json:
        for row in rows:
            json_line(row)
    else:
        table(
            "certificates", ("name", "role", "until", "days left"), (row.values() for row in rows)
        )


def acl(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of the authority, as `certs` made it.")
    ],
    out: Annotated[Path | None, typer.Option("--out", help="File to write; stdout.")] = None,
    config: Config = None,
) -> None:
    """Write the rules of Zenoh's access control for the certificates of an authority.

    Name the file as zenoh_config of every router, and start the routers again: what no rule allows
    is denied.
    """
    import json as encoder

    from service.output_files import save_text
    from service.security.access_rules import access_rules
    from service.security.authority import certificate_name, open_authority, role_of

    if not (folder / "ca.pem").exists():
        raise UsageError(f"no authority here; `counterpoint certs` makes one ({folder})")
    settings = settings_for(config)
    names: dict[str, list[str]] = {}
    for each in open_authority(folder).certificates():
        names.setdefault(role_of(each), []).append(certificate_name(each))
    rules = encoder.dumps(access_rules(names, root=settings.root), indent=1)
    if out is None:
        page(f"{rules}\n")
        return
    save_text(f"{rules}\n", out, option="--out", force=False)
    remark(f"rules for {sum(map(len, names.values()))} certificates: {out}")


def token(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File of tokens, http_tokens.")],
    name: Annotated[str, typer.Option("--name", help="Who it is for.")],
    role: Annotated[str, typer.Option("--role", help=f"One of {', '.join(ROLES)}.")] = "viewer",
    revoke: Annotated[
        bool, typer.Option("--revoke", help="Take every token of this name out instead.")
    ] = False,
    revoke_older: Annotated[
        bool,
        typer.Option("--revoke-older", help="Take all but the newest of this name out instead."),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Private file for the token, such as Prometheus reads; stdout."),
    ] = None,
) -> None:
    """Make a token that opens the pages; the file keeps its digest, and the token is printed once.

    A change of the file counts at once, without a restart. Other tokens of the name stay valid
    until they are revoked, so that one can be replaced without a gap.
    """
    from schemas.runtime.private_file import read_private, write_private

    if out is not None and (out.is_symlink() or out.exists()):
        raise UsageError(f"--out: this file exists: name another, or remove it first ({out})")
    if not is_role(role):
        raise UsageError(f"--role is one of {', '.join(ROLES)}, not {role!r}")
    if revoke and revoke_older:
        raise UsageError("give one of --revoke and --revoke-older")
    made = new_token()
    line = token_line(name, role, made)  # type: ignore[arg-type]
    lines = []
    if file.exists():
        lines = read_private(file, what="http_tokens").decode("utf-8").splitlines()
    before = [number for number, each in enumerate(lines) if _is_token_of(each, name)]
    if revoke or revoke_older:
        if not before:
            raise UsageError(f"no token of the name {name!r} ({file})")
        out_of_use = before if revoke else before[:-1]
        kept = [each for number, each in enumerate(lines) if number not in out_of_use]
        write_private(file, "".join(f"{each}\n" for each in kept).encode())
        rest = "" if revoke else "; the newest stays valid"
        remark(f"revoked: {len(out_of_use)} tokens of {name}{rest} ({file})")
        return
    write_private(file, "".join(f"{each}\n" for each in [*lines, line]).encode())
    if out is None:
        result_line(made)
    else:
        write_private(out, f"{made}\n".encode())
    kept_in = f"{out} has the token" if out else "the token itself is kept nowhere else"
    remark(f"token of {name}, {role}: {file} has its digest; {kept_in}")
    if before:
        remark(
            f"{len(before)} older tokens of {name} stay valid: once the new one is in use, end "
            f"them by `counterpoint token {file} --name {name} --revoke-older`",
            level="warning",
        )


def _is_token_of(line: str, name: str) -> bool:
    return line.partition("#")[0].split()[1:2] == [name]


def audit(
    most: Annotated[
        int, typer.Option("-n", "--most", min=1, max=MAX_AUDIT_ASKED, help="Rows at most.")
    ] = 100,
    before: Annotated[
        int | None,
        typer.Option("--before", min=0, max=MAX_INTEGER, help="Only rows before this number."),
    ] = None,
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Print who selected, judged, retried and exported what, and when; the latest first.

    The exit code is 1 if a row was changed or deleted after it was written.
    """
    source = reader(config, connect=connect, state=state, database=database)
    rows = source.audit(AuditRequest(most=most, before=before)).rows
    if json:
        for row in rows:
            json_line(row)
    else:
        table(
            "audit",
            ("number", "when", "who", "says", "by", "what", "detail"),
            (
                (str(row.ordinal), _when(row), row.name, row.says, row.via, row.what, row.detail)
                for row in rows
            ),
        )
    if broken := [row.ordinal for row in rows if not row.is_whole]:
        raise UsageError(
            f"the audit log was changed after it was written, at row {broken[-1]} or before it"
        )


def sbom() -> None:
    """Print what this installation is made of: CycloneDX 1.5, JSON."""
    import json as encoder

    from service.security.sbom import bill_of_materials

    page(f"{encoder.dumps(bill_of_materials(), indent=1)}\n")


def _when(row: AuditRow) -> str:
    return datetime.fromtimestamp(row.at_s, tz=UTC).strftime("%Y-%m-%d %H:%M:%S")
