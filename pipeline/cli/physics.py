"""Commands on the atmosphere and on rays through it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from pipeline.cli.app import app, end_command, new_console, write_rows_csv
from pipeline.errors import ConfigError


class _AngleCommand(TyperCommand):
    """`unbend angle`: --method lists all methods, which are imported when the command is used."""

    def get_params(self, ctx: Any) -> list[Any]:
        from pipeline.refraction import METHODS

        params: list[Any] = super().get_params(ctx)
        next(p for p in params if p.name == "method").help = ", ".join(METHODS)
        return params


@app.command(
    cls=_AngleCommand,
    # \b: not to be wrapped again, which would break words at their hyphens.
    epilog="\b\nExample: unbend angle --atmosphere us1976 --index gyer \\\n"
    "  --camera-height 10000 --ground-height 0 --nadir-angle 75",
)
def angle(
    *,
    camera_height: Annotated[float, typer.Option(help="metres above sea level")],
    ground_height: Annotated[float, typer.Option(help="metres above sea level")],
    nadir_angle: Annotated[float, typer.Option(help="apparent nadir angle, degrees, 0 to 180")],
    atmosphere: Annotated[str, typer.Option(help="name of a standard atmosphere")] = "us1976",
    method: Annotated[str, typer.Option()] = "spherical",
    index: Annotated[str, typer.Option(help="ciddor or gyer (Eq. 13)")] = "ciddor",
    radius: Annotated[float, typer.Option(help="radius of the earth, metres")] = 6_371_000.0,
    distance: Annotated[
        float | None,
        typer.Option(help="slant range, metres: which of two crossings is meant (spherical)"),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="as JSON")] = False,
) -> None:
    """One refraction angle: arcsec, microradians, ground metres."""
    from pipeline.refraction.angle import one_angle
    from pipeline.report.terminal import print_angle

    result = one_angle(
        atmosphere=atmosphere,
        index=index,
        camera_height=camera_height,
        ground_height=ground_height,
        nadir_angle=nadir_angle,
        radius=radius,
        method=method,
        distance=distance,
    )
    if as_json:
        print(json.dumps(result, indent=2, allow_nan=False))
    else:
        print_angle(new_console(), result)


@app.command(
    epilog="\b\nExample: unbend radial --atmosphere us1976 --camera-height 3000 \\\n"
    "  --camera-height 6000 --ground-height 0 --focal-px 20000"
)
def radial(
    *,
    camera_height: Annotated[
        list[float], typer.Option(help="metres above sea level; may be given several times")
    ],
    ground_height: Annotated[float, typer.Option(help="metres above sea level")],
    atmosphere: Annotated[str | None, typer.Option(help="name of a standard atmosphere")] = None,
    config: Annotated[Path | None, typer.Option(help="a mission file: the air it flew in")] = None,
    focal_px: Annotated[float | None, typer.Option(help="principal distance, pixels")] = None,
    max_angle: Annotated[float, typer.Option(help="largest nadir angle, degrees")] = 60.0,
    step: Annotated[float, typer.Option(min=0.01, help="degrees between rows")] = 5.0,
    radius: Annotated[float, typer.Option(help="radius of the earth, metres")] = 6_371_000.0,
    csv: Annotated[Path | None, typer.Option(help="write the rows as CSV")] = None,
) -> None:
    """Refraction by nadir angle per flying height; the Manual's K.

    K is R at 45 degrees; beside it stands what the Manual of Photogrammetry's formula gives. No
    metres on the ground are given where only the bent ray lands and the straight one passes over
    the horizon.
    """
    from pipeline.refraction.angle import angles_to, radial_table
    from pipeline.report.progress import DelayedProgressBar
    from pipeline.report.terminal import print_radial, radial_rows
    from pipeline.stages.story import air_of_mission_or_standard

    _require_one_atmosphere(config, atmosphere)
    console = new_console()
    angles = angles_to(max_angle, step)
    with DelayedProgressBar(console, "estimating the air"):
        air, _, ledger = air_of_mission_or_standard(config, atmosphere)
    tables = [
        radial_table(
            air.adjustment.profile, h, ground_height, angles, focal_px=focal_px, radius=radius
        )
        for h in camera_height
    ]
    if csv is not None:
        write_rows_csv(csv, radial_rows(tables))
    else:
        print_radial(console, tables)
    end_command(console, ledger, csv)


@app.command(epilog="Example: unbend tables gyer1996 --csv gyer.csv")
def tables(
    paper: Annotated[
        str, typer.Argument(help="gyer1996, saastamoinen1974 or bertram1966", metavar="PAPER")
    ],
    csv: Annotated[Path | None, typer.Option(help="write the rows as CSV")] = None,
) -> None:
    """Recompute a paper's tables: as printed, as published, and exact."""
    from pipeline.refraction.papers import paper_tables
    from pipeline.report.terminal import print_paper

    table = paper_tables(paper)
    if csv is None:
        print_paper(new_console(), table.rows(), table.notes)
    else:
        write_rows_csv(csv, table.rows())


@app.command(
    epilog="\b\nExample: unbend profile mission.yaml --plot air.png\n"
    "or: unbend profile --atmosphere us1976 --step 1000"
)
def profile(
    config: Annotated[
        Path | None, typer.Argument(help="a mission file", metavar="[CONFIG]")
    ] = None,
    atmosphere: Annotated[str | None, typer.Option(help="name of a standard atmosphere")] = None,
    csv: Annotated[Path | None, typer.Option(help="write the profile as CSV")] = None,
    plot: Annotated[Path | None, typer.Option(help="draw it, .png or .svg")] = None,
    step: Annotated[
        float | None,
        typer.Option(min=1, max=10_000, help="metres between rows; by default the layers' edges"),
    ] = None,
) -> None:
    """The air of a mission or of a standard: a table, CSV or plot."""
    from pipeline.atmosphere.profile import heights_every
    from pipeline.report.progress import DelayedProgressBar
    from pipeline.report.terminal import print_air, print_profile
    from pipeline.stages.story import air_of_mission_or_standard
    from pipeline.tables.writing import table_of_profile, table_of_profiles

    _require_one_atmosphere(config, atmosphere)
    console = new_console()
    with DelayedProgressBar(console, "estimating the air"):
        air, samples, ledger = air_of_mission_or_standard(config, atmosphere)
    adjustment = air.adjustment
    heights = None if step is None else heights_every(adjustment.profile, step)
    rows = table_of_profile(adjustment, "", heights).drop_columns(["profile_id", "time_utc"])
    if csv is not None:
        several = len(air.series.timed_profiles) > 1
        whole = table_of_profiles(adjustment, air.series, heights) if several else rows
        write_rows_csv(csv, whole.to_pylist())
    if plot is not None:
        from pipeline.report.figures import profile_figure, save_figure

        save_figure(profile_figure(air, samples), plot)
    if csv is None and plot is None:
        print_profile(console, rows.to_pylist(), adjustment.standard.name)
    print_air(console, air)
    end_command(console, ledger, csv, plot)


@app.command(epilog="Example: unbend compare --out docs/accuracy.md")
def compare(
    atmosphere: Annotated[str, typer.Option(help="name of a standard atmosphere")] = "us1976",
    out: Annotated[
        Path | None, typer.Option(help="write the page as Markdown, its picture beside it as .png")
    ] = None,
) -> None:
    """How far each published method can be trusted.

    By flying height: to which nadir angle it stays within 0.1 and 1 arcsec of the spherical ray.
    """
    from pipeline.report.accuracy import compare_all, print_accuracy
    from pipeline.stages.story import write_comparison

    comparisons = compare_all(atmosphere)
    if out is None:
        print_accuracy(new_console(), comparisons)
    else:
        write_comparison(comparisons, out)


def _require_one_atmosphere(config: Path | None, atmosphere: str | None) -> None:
    if (config is None) == (atmosphere is None):
        what = "give either a mission file or --atmosphere"
        raise ConfigError("PROFILE-ARGUMENTS", what, remedy="for example: --atmosphere us1976")
