"""Verb `plan`: cores, bytes, disk and money that a fleet costs."""

from contextlib import closing
from pathlib import Path
from typing import Annotated, Final

import typer

from service.cli.options import Config, Database, Json, StateToRead, settings_for
from service.cli.output import json_line, remark, table
from service.fleet_costs import (
    OVERLAY_BYTES_A_POINT,
    Fleet,
    FleetCosts,
    FrameRates,
    Prices,
    costs_of,
)
from service.store.engine import has_database
from service.store.opening import open_ledger_store_to_read
from service.store.throughput import pace

_PRICES: Final = Prices()


def add_to(app: typer.Typer) -> None:
    """Add the verb of this file to the command."""
    app.command(epilog="counterpoint plan --cars 100 --hours 8 --price-core-hour 0.03")(plan)


def plan(
    cars: Annotated[int, typer.Option("--cars", min=1, max=10_000_000, help="Cars a day.")],
    hours: Annotated[
        float, typer.Option("--hours", min=0.001, max=24, help="Hours that each records in a day.")
    ],
    *,
    lidars: Annotated[int, typer.Option("--lidars", min=1, max=256, help="Of each car.")] = 1,
    hz: Annotated[float, typer.Option("--hz", min=0.1, max=100, help="Frames a second.")] = 10.0,
    keep_days: Annotated[
        float, typer.Option("--keep-days", min=0, max=36_500, help="Days that overlays are kept.")
    ] = 90.0,
    seconds_per_frame: Annotated[
        float | None,
        typer.Option(
            "--seconds-per-frame", min=1e-6, max=3600, help="Of one core; default: measured."
        ),
    ] = None,
    price_core_hour: Annotated[
        float, typer.Option("--price-core-hour", min=0, max=1e6, help="Of one core for an hour.")
    ] = _PRICES.core_hour,
    price_gb_month: Annotated[
        float, typer.Option("--price-gb-month", min=0, max=1e6, help="Of one GB kept for a month.")
    ] = _PRICES.gb_month,
    price_gb_read: Annotated[
        float, typer.Option("--price-gb-read", min=0, max=1e6, help="Of one GB read.")
    ] = _PRICES.gb_read,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Estimate what a fleet costs, from the rates measured in --state, else from stated ones."""
    rates = _rates(config, state, database)
    if seconds_per_frame is not None:
        rates = FrameRates(
            seconds_per_frame, rates.bytes_read, rates.overlay_bytes, rates.measured_frames
        )
    settings = settings_for(config, state=state, database=database)
    fleet = Fleet(cars, hours, lidars, hz, settings.grid.scene_s, keep_days)
    costs = costs_of(fleet, rates, Prices(price_core_hour, price_gb_month, price_gb_read))
    if json:
        json_line(costs.model_dump(mode="json"))
        return
    table(f"{cars} cars, {hours:g} hours a day", ("what", "a day", "a month"), _lines(costs))
    remark(
        f"money a month: {costs.money_a_month:,.0f}, of an hour driven: "
        f"{costs.money_an_hour_driven:.3f} (core-hour {price_core_hour:g}, GB kept for a month "
        f"{price_gb_month:g}, GB read {price_gb_read:g})"
    )
    basis = (
        f"measured on {costs.measured_frames} frames mined in this state"
        if costs.measured_frames
        else "as measured elsewhere on frames of 106,000 points; give --state for your own"
    )
    remark(f"{costs.seconds_per_frame:.3f} s of one core per frame, {basis}")


def _lines(costs: FleetCosts) -> list[tuple[str, str, str]]:
    def line(what: str, a_day: float, unit: str = "") -> tuple[str, str, str]:
        return what, f"{a_day:,.0f}{unit}", f"{a_day * 30:,.0f}{unit}"

    return [
        line("frames", costs.frames_a_day),
        line("scenes", costs.scenes_a_day),
        line("core-hours", costs.core_hours_a_day),
        ("cores, all day", f"{costs.cores:,.1f}", ""),
        line("read from the bucket", costs.read_gb_a_day, " GB"),
        line("overlays written", costs.overlay_gb_a_day, " GB"),
        ("overlays on disk", f"{costs.overlay_gb_kept:,.0f} GB", ""),
        ("database in a year", f"{costs.database_gb_a_year:,.1f} GB", ""),
        ("money for cores", "", f"{costs.core_money_a_month:,.0f}"),
        ("money for reading", "", f"{costs.read_money_a_month:,.0f}"),
        ("money for disk", "", f"{costs.disk_money_a_month:,.0f}"),
    ]


def _rates(config: Path | None, state: Path | None, database: str | None) -> FrameRates:
    """Return the rates measured in a state; the defaults where it has none."""
    settings = settings_for(config, state=state, database=database)
    if not settings.database and not has_database(settings.state):
        return FrameRates()
    with closing(open_ledger_store_to_read(settings)) as store, store.reading() as connection:
        found = pace(connection)
    if found is None:
        return FrameRates()
    return FrameRates(
        found.seconds_per_frame,
        found.bytes_per_frame,
        found.points_per_frame * OVERLAY_BYTES_A_POINT,
        found.frames,
    )
