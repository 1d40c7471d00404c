"""Commands on the atmosphere and on rays through it."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option
from typer.core import TyperCommand

from unbend.cli.app import Answer, command, write_rows_csv
from unbend.errors import ConfigError

if TYPE_CHECKING:
    from unbend.report.accuracy import Accuracy


def _methods() -> list[str]:
    """Names that a shell completes; imported when it asks."""
    from unbend.refraction import METHODS

    return list(METHODS)


_NAMED = Option(
    help="name of a standard atmosphere",
    autocompletion=lambda: list(import_module("unbend.atmosphere.standard").ATMOSPHERES),
)
Atmosphere = Annotated[str, _NAMED]
Radius = Annotated[float, Option(help="radius of the earth, metres")]


class _AngleCommand(TyperCommand):
    """`unbend angle`: --method lists all methods, which are imported when the command is used."""

    def get_params(self, ctx: Any) -> list[Any]:
        params: list[Any] = super().get_params(ctx)
        next(p for p in params if p.name == "method").help = ", ".join(_methods())
        return params


@command(
    cls=_AngleCommand,
    # \b: not to be wrapped again, which would break words at their hyphens.
    epilog="\b\nExample: unbend angle --atmosphere us1976 --index gyer \\\n"
    "  --camera-height 10000 --ground-height 0 --nadir-angle 75",
)
def angle(
    answer: Answer,
    *,
    camera_height: Annotated[float, Option(help="metres above sea level")],
    ground_height: Annotated[float, Option(help="metres above sea level")],
    nadir_angle: Annotated[float, Option(help="apparent nadir angle, degrees, 0 to 180")],
    atmosphere: Atmosphere = "us1976",
    method: Annotated[str, Option(autocompletion=_methods)] = "spherical",
    index: Annotated[str, Option(help="ciddor or gyer (Eq. 13)")] = "ciddor",
    radius: Radius = 6_371_000.0,
    distance: Annotated[
        float | None,
        Option(help="slant range, metres: which of two crossings is meant (spherical)"),
    ] = None,
) -> None:
    """One refraction angle: arcsec, microradians, ground metres.

    To five digits; all of them with --json.
    """
    with answer.progress("tracing the ray"):
        from unbend.refraction.angle import one_angle
        from unbend.report.air_and_rays import print_angle

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
    answer.print_json(result)
    print_angle(answer.console, result)


@command(
    epilog="\b\nExample: unbend radial --atmosphere us1976 --camera-height 3000 \\\n"
    "  --camera-height 6000 --ground-height 0 --focal-px 20000"
)
def radial(
    answer: Answer,
    *,
    camera_height: Annotated[
        list[float], Option(help="metres above sea level; may be given several times")
    ],
    ground_height: Annotated[float, Option(help="metres above sea level")],
    atmosphere: Annotated[str | None, Option(help="name of a standard atmosphere")] = None,
    config: Annotated[Path | None, Option(help="a mission file: the air it flew in")] = None,
    focal_px: Annotated[float | None, Option(help="principal distance, pixels")] = None,
    max_angle: Annotated[float, Option(help="largest nadir angle, degrees")] = 60.0,
    step: Annotated[float, Option(min=0.01, help="degrees between rows")] = 5.0,
    radius: Radius = 6_371_000.0,
    csv: Annotated[Path | None, Option(help="write the rows as CSV")] = None,
) -> None:
    """Refraction by nadir angle per flying height; the Manual's K.

    K is R at 45 degrees; beside it stands what the Manual of Photogrammetry's formula gives. No
    metres on the ground are given where only the bent ray lands and the straight one passes over
    the horizon.
    """
    _require_one_atmosphere(config, atmosphere)
    with answer.progress("estimating the air"):
        from unbend.batch.runs import air_of_mission_or_standard
        from unbend.refraction.angle import angles_to, radial_table
        from unbend.report.air_and_rays import print_radial, radial_rows

        angles = angles_to(max_angle, step)
        air, _, ledger = air_of_mission_or_standard(config, atmosphere)
        profile = air.adjustment.profile
        tables = [
            radial_table(profile, h, ground_height, angles, focal_px=focal_px, radius=radius)
            for h in camera_height
        ]
        rows = radial_rows(tables)
    if csv is not None:
        write_rows_csv(csv, rows)
    else:
        print_radial(answer.console, tables)
    answer.end({"rows": rows}, ledger, csv)


@command(epilog="Example: unbend tables gyer1996 --csv gyer.csv")
def tables(
    answer: Answer,
    paper: Annotated[
        str, Argument(help="gyer1996, saastamoinen1974 or bertram1966", metavar="PAPER")
    ],
    csv: Annotated[Path | None, Option(help="write the rows as CSV")] = None,
) -> None:
    """Recompute a paper's tables: as printed, as published, and exact."""
    with answer.progress("computing the tables"):
        from unbend.refraction.printed_tables import paper_tables
        from unbend.report.air_and_rays import print_paper

        table = paper_tables(paper)
        rows = table.rows()
    if csv is None:
        print_paper(answer.console, rows, table.notes)
    else:
        write_rows_csv(csv, rows)
    answer.print_json({"rows": rows, "notes": table.notes})


@command(
    epilog="\b\nExample: unbend profile mission.yaml --plot air.png\n"
    "or: unbend profile --atmosphere us1976 --step 1000"
)
def profile(
    answer: Answer,
    config: Annotated[Path | None, Argument(help="a mission file", metavar="[CONFIG]")] = None,
    atmosphere: Annotated[str | None, Option(help="name of a standard atmosphere")] = None,
    csv: Annotated[Path | None, Option(help="write the profile as CSV")] = None,
    plot: Annotated[Path | None, Option(help="draw it, .png or .svg")] = None,
    *,
    step: Annotated[
        float | None,
        Option(min=1, max=10_000, help="metres between rows; by default the layers' edges"),
    ] = None,
) -> None:
    """The air of a mission or of a standard: a table, CSV or plot."""
    _require_one_atmosphere(config, atmosphere)
    with answer.progress("estimating the air"):
        from unbend.atmosphere.profile import heights_every
        from unbend.batch.runs import air_of_mission_or_standard
        from unbend.report.air_and_rays import print_air, print_profile
        from unbend.tables.writing import table_of_profile, table_of_profiles

        air, samples, ledger = air_of_mission_or_standard(config, atmosphere)
    adjustment = air.adjustment
    heights = None if step is None else heights_every(adjustment.profile, step)
    rows = table_of_profile(adjustment, "", heights).drop_columns(["profile_id", "time_utc"])
    if csv is not None:
        several = len(air.series.timed_profiles) > 1
        whole = table_of_profiles(adjustment, air.series, heights) if several else rows
        write_rows_csv(csv, whole.to_pylist())
    if plot is not None:
        with answer.progress(f"drawing {plot.name}"):
            from unbend.report.figures import profile_figure, save_figure

            save_figure(profile_figure(air, samples), plot)
    if csv is None and plot is None:
        print_profile(answer.console, rows.to_pylist(), adjustment.standard.name)
    print_air(answer.console, air)
    effects = [effect.row() for effect in air.effects]
    answer.end({"profile": rows.to_pylist(), "effect": effects}, ledger, csv, plot)


@command(epilog="Example: unbend compare --out docs/accuracy.md")
def compare(
    answer: Answer,
    atmosphere: Atmosphere = "us1976",
    out: Annotated[
        Path | None, Option(help="write the page as Markdown, its picture beside it as .png")
    ] = None,
) -> None:
    """How far each published method can be trusted.

    By flying height: to which nadir angle it stays within 0.1 and 1 arcsec of the spherical ray.
    """
    with answer.progress("comparing the methods"):
        from unbend.report.accuracy import compare_all, comparison_rows, print_accuracy

        comparisons = compare_all(atmosphere)
        if out is not None:
            write_comparison(comparisons, out)
    if out is None:
        print_accuracy(answer.console, comparisons)
    answer.print_json({"atmosphere": atmosphere, "rows": comparison_rows(comparisons)})


def write_comparison(accuracy: "Accuracy", path: Path) -> None:
    """Write the comparison of the methods as a page, and its picture beside it."""
    from unbend.batch.store import atomic_write
    from unbend.report.accuracy import accuracy_page, accuracy_png, text_hash

    if path.suffix.lower() != ".md":
        raise ConfigError.of("PAGE-FORMAT", path, suffix=path.suffix or "nothing")
    picture = path.with_suffix(".png")
    text = accuracy_page(accuracy, picture.name)
    png = accuracy_png(accuracy.curves, text_hash(text))
    for target, content in ((path, text.encode()), (picture, png)):
        with atomic_write(target) as draft:
            draft.write_bytes(content)


def _require_one_atmosphere(config: Path | None, atmosphere: str | None) -> None:
    if (config is None) == (atmosphere is None):
        what = "give either a mission file or --atmosphere"
        raise ConfigError("PROFILE-ARGUMENTS", what, remedy="for example: --atmosphere us1976")
