"""Verbs about weights: `weights import` and `weights configs`."""

from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import Force, Json
from service.cli.output import json_line, remark
from service.errors import UsageError
from service.output_files import need_folder


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    weights = typer.Typer(no_args_is_help=True, help="Import weights of published networks.")
    weights.command(
        "import",
        epilog="counterpoint weights import SalsaNext_valid_best --network salsanext "
        "--config salsanext-semantickitti --out weights",
    )(import_)
    weights.command(epilog="counterpoint weights configs")(configs)
    app.add_typer(weights, name="weights")


def import_(
    checkpoint: Annotated[Path, typer.Argument(help="Published checkpoint, or safetensors.")],
    network: Annotated[
        str,
        typer.Option("--network", help="Network: salsanext, lmnet, gndnet, flowstep3d or delora."),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder for the weights.")],
    config: Annotated[
        str | None,
        typer.Option(
            "--config",
            help="Required: the network's configuration, as a JSON file, JSON, or a name that "
            "weights configs lists.",
        ),
    ] = None,
    json: Json = False,
    force: Force = False,
) -> None:
    """Convert a checkpoint into weights that parts load; code in it is refused and never run."""
    from workers.parts.networks import (
        import_weights,
        known_configs,
        need_no_other_weights,
        read_known,
    )

    if config is None:
        fitting = [name for name in known_configs() if read_known(name).network == network]
        raise UsageError(
            f"--config is missing: the configuration of {network}, as a JSON file or a "
            f"name that `counterpoint weights configs` lists ({', '.join(fitting) or 'none fits'})"
        )
    need_folder(out, option="--out")
    if not force:
        need_no_other_weights(out / f"{network}.safetensors", checkpoint)
    imported = import_weights(checkpoint, network=network, config=config, out=out)
    if json:
        json_line(
            {
                "network": imported.network,
                "path": str(imported.path),
                "parameters": imported.parameters,
                "sha256": imported.digest,
                "converted": imported.converted,
            }
        )
        return
    if imported.converted:
        remark("the training state in the checkpoint was left out, only parameters are kept")
    remark(
        f"{imported.network}: {imported.parameters} tensors, all of them fit ({imported.path}; "
        f"sha256 of weights and card {imported.digest[:12]})"
    )


def configs(json: Json = False) -> None:
    """List the configurations of published checkpoints that come with the package."""
    from service.cli.output import table
    from workers.parts.networks import known_configs, read_known

    cards = [(name, read_known(name)) for name in known_configs()]
    if json:
        for name, card in cards:
            json_line({"config": name, **card.model_dump(mode="json")})
        return
    table(
        "configurations of published checkpoints",
        ("config", "network", "of", "licence of the training data"),
        ((name, card.network, card.attribution, card.data_license) for name, card in cards),
    )
