"""Commands on the atmosphere and on rays through it."""

from collections.abc import Iterable
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

from typer import Argument, Option
from typer.core import TyperCommand

from unbend.cli import messages
from unbend.cli.app import Answer, HelpContext, HelpFormatter, command, write_rows_csv

if TYPE_CHECKING:
    from unbend.report.accuracy import Accuracy

DEFAULT_ATMOSPHERE = "us1976"
DEFAULT_METHOD = "spherical"
DEFAULT_INDEX = "ciddor"
ACCURACY = "accuracy"  # in place of a paper: a comparison of all published methods
LARGEST_ANGLE_DEG = 60.0  # of a table of angles, by default
STEP_DEG = 5.0  # between its rows, by default


def _methods() -> list[str]:
    """The names of the methods; they are imported only when a shell or the help needs them."""
    from unbend.refraction import METHODS

    return list(METHODS)


def _atmospheres() -> list[str]:
    """The names of the standard atmospheres; they are imported only when a shell needs them."""
    return list(import_module("unbend.atmosphere.standard").ATMOSPHERES)


CameraHeights = Annotated[
    list[float],
    Option(help="metres above sea level; for a table it can be given several times"),
]
NadirAngle = Annotated[
    float | None,
    Option(help="apparent nadir angle, degrees, 0 to 180; without it: a table"),
]
StandardName = Annotated[
    str | None,
    Option(help="name of a standard atmosphere, by default us1976", autocompletion=_atmospheres),
]
MethodName = Annotated[
    str,
    Option(help="how the ray is computed, see below", autocompletion=_methods),
]
Wavelength = Annotated[
    float | None,
    Option(help="of the light in vacuum, metres, by default 0.55e-6"),
]
SlantRange = Annotated[
    float | None,
    Option(help="slant range, metres: it decides between two crossings (spherical)"),
]
MissionOfTable = Annotated[
    Path | None,
    Option(help="of a table: a mission file, for the air of its flight"),
]
MaxAngle = Annotated[
    float | None,
    Option(help="of a table: largest nadir angle, degrees, by default 60"),
]
StepOfTable = Annotated[
    float | None,
    Option(min=0.01, help="of a table: degrees between rows, by default 5"),
]
CameraOfMission = Annotated[
    str | None,
    Option(help="with --config: the name of the camera that gives the wavelength"),
]


class _AngleCommand(TyperCommand):
    """`unbend angle`: its help lists all methods, which are imported when it is shown."""

    def format_options(self, ctx: HelpContext, formatter: HelpFormatter) -> None:
        """Write the options, and below them the names of the methods."""
        super().format_options(ctx, formatter)
        with formatter.section("Methods"):
            formatter.write_text(", ".join(_methods()))


@command(
    cls=_AngleCommand,
    # \b: not to be wrapped again, which would break words at their hyphens.
    epilog="\b\nExample: unbend angle --atmosphere us1976 --index gyer \\\n"
    "  --camera-height 10000 --ground-height 0 --nadir-angle 75\n"
    "or: unbend angle --camera-height 3000 --camera-height 6000 \\\n"
    "  --ground-height 0 --focal-px 20000",
)
def angle(
    answer: Answer,
    *,
    camera_height: CameraHeights,
    ground_height: Annotated[float, Option(help="metres above sea level")],
    nadir_angle: NadirAngle = None,
    atmosphere: StandardName = None,
    method: MethodName = DEFAULT_METHOD,
    index: Annotated[str, Option(help="ciddor or gyer (Eq. 13)")] = DEFAULT_INDEX,
    wavelength: Wavelength = None,
    radius: Annotated[float, Option(help="radius of the earth, metres")] = 6_371_000.0,
    distance: SlantRange = None,
    config: MissionOfTable = None,
    camera: CameraOfMission = None,
    focal_px: Annotated[float | None, Option(help="of a table: principal distance, pixels")] = None,
    max_angle: MaxAngle = None,
    step: StepOfTable = None,
    csv: Annotated[Path | None, Option(help="of a table: write the rows as CSV")] = None,
) -> None:
    """One refraction angle, or a table of them by nadir angle.

    One angle: arcsec, microradians, ground metres, with five digits (with --json: all digits).
    A table has K, which is R at 45 degrees, and next to it K of the Manual of Photogrammetry's
    formula. It has no metres on the ground if only the bent ray reaches the ground and the
    straight one is above the horizon. With --focal-px it has the correction dr of a camera that
    looks down: add it to the measured radius.
    """
    if nadir_angle is None:
        refuse_options_of_one_angle(method, index, distance)
        print_table_of_angles(
            answer,
            camera_height,
            ground_height,
            atmosphere=atmosphere,
            config=config,
            camera=camera,
            wavelength=wavelength,
            focal_px=focal_px,
            max_angle=max_angle,
            step=step,
            radius=radius,
            csv=csv,
        )
    else:
        table_options = (config, camera, focal_px, max_angle, step, csv)
        refuse_options_of_table(camera_height, table_options)
        with answer.progress("tracing the ray"):
            from unbend.atmosphere.refractive_index import DEFAULT_WAVELENGTH_M, IndexModel
            from unbend.refraction.angle import one_angle
            from unbend.report.air_and_rays import print_angle

            if wavelength is None:
                wavelength = DEFAULT_WAVELENGTH_M
            result = one_angle(
                atmosphere=atmosphere or DEFAULT_ATMOSPHERE,
                index=IndexModel(index, wavelength),
                camera_height=camera_height[0],
                ground_height=ground_height,
                nadir_angle=nadir_angle,
                radius=radius,
                method=method,
                distance=distance,
            )
        answer.print_json(result)
        print_angle(answer.console, result)


def refuse_options_of_one_angle(method: str, index: str, distance: float | None) -> None:
    """Refuse (ANGLE-ARGUMENTS) options for one angle in a command for a table of angles.

    A value that differs from the default was given.
    """
    if method != DEFAULT_METHOD or index != DEFAULT_INDEX or distance is not None:
        raise messages.angle_options(options="--method, --index, --distance", other="one angle")


def refuse_options_of_table(camera_heights: list[float], table_options: Iterable[object]) -> None:
    """Refuse (ANGLE-ARGUMENTS) options for a table of angles in a command for one angle.

    ``table_options`` are the values of these options, None for an option that was not given.
    """
    if len(camera_heights) > 1 or any(value is not None for value in table_options):
        raise messages.angle_options(
            options="several heights, --config, --camera, --focal-px, --max-angle, --step, --csv",
            other="a table",
        )


def print_table_of_angles(
    answer: Answer,
    camera_heights: list[float],
    ground_height: float,
    *,
    atmosphere: str | None,
    config: Path | None,
    camera: str | None,
    wavelength: float | None,
    focal_px: float | None,
    max_angle: float | None,
    step: float | None,
    radius: float,
    csv: Path | None,
) -> NoReturn:
    """Print refraction by nadir angle and flying height, or write it to ``csv``; then exit.

    Heights and ``radius`` are metres, ``wavelength`` metres in vacuum, ``max_angle`` and ``step``
    degrees. None takes the default.
    """
    if config is None and atmosphere is None:
        atmosphere = DEFAULT_ATMOSPHERE
    require_one_atmosphere(config, atmosphere)  # refuses if both are given
    if max_angle is None:
        max_angle = LARGEST_ANGLE_DEG
    if step is None:
        step = STEP_DEG
    if camera is not None and config is None:
        raise messages.camera_without_config()
    with answer.progress("estimating the air"):
        from unbend.batch.runs import profile_in_light
        from unbend.refraction.angle import angles_to, radial_table
        from unbend.report.air_and_rays import print_radial, radial_rows

        angles = angles_to(max_angle, step)
        profile, ledger = profile_in_light(
            config, atmosphere, camera=camera, wavelength_m=wavelength
        )
        tables = []
        for height in camera_heights:
            table = radial_table(
                profile,
                height,
                ground_height,
                angles,
                focal_px=focal_px,
                radius=radius,
            )
            tables.append(table)
        rows = radial_rows(tables)
    if csv is not None:
        write_rows_csv(csv, rows)
    else:
        print_radial(answer.console, tables)
    answer.end({"rows": rows}, ledger, csv)


@command(epilog="Example: unbend tables gyer1996 --csv gyer.csv; unbend tables accuracy")
def tables(
    answer: Answer,
    paper: Annotated[
        str,
        Argument(help="gyer1996, saastamoinen1974, bertram1966, or accuracy", metavar="PAPER"),
    ],
    csv: Annotated[Path | None, Option(help="write the rows as CSV")] = None,
    atmosphere: Annotated[
        str,
        Option(help="of accuracy: name of a standard atmosphere", autocompletion=_atmospheres),
    ] = DEFAULT_ATMOSPHERE,
    out: Annotated[
        Path | None,
        Option(
            help=(
                "of accuracy: write the page as Markdown, with its picture "
                "as .png in the same folder"
            )
        ),
    ] = None,
) -> None:
    """Recompute a paper's tables: as printed, as published, and exact.

    `accuracy` shows the accuracy of each published method: for each flying height, the nadir
    angle up to which its error stays below 0.1 and 1 arcsec of the spherical ray.
    """
    if paper == ACCURACY:
        print_accuracy_of_methods(answer, atmosphere, csv, out)
        return
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


def print_accuracy_of_methods(
    answer: Answer, atmosphere: str, csv: Path | None, out: Path | None
) -> None:
    """Compare all published methods with the exact ray, and print or write the comparison.

    ``csv`` gets the rows, ``out`` the page; without both a table is printed.
    """
    with answer.progress("comparing the methods"):
        from unbend.report.accuracy import compare_all, comparison_rows, print_accuracy

        comparisons = compare_all(atmosphere)
        rows = comparison_rows(comparisons)
        if out is not None:
            write_comparison(comparisons, out)
        if csv is not None:
            write_rows_csv(csv, rows)
    if out is None and csv is None:
        print_accuracy(answer.console, comparisons)
    answer.print_json({"atmosphere": atmosphere, "rows": rows})


def write_comparison(accuracy: "Accuracy", path: Path) -> None:
    """Write the comparison of the methods as a Markdown page, with its picture in the same folder.

    Refuses (PAGE-FORMAT) a path that does not end in .md.
    """
    from unbend.batch.store import atomic_write
    from unbend.report.accuracy import accuracy_page, accuracy_png, text_hash

    if path.suffix.lower() != ".md":
        raise messages.page_not_markdown(path=str(path), suffix=path.suffix)
    picture = path.with_suffix(".png")
    text = accuracy_page(accuracy, picture.name)
    png = accuracy_png(accuracy.curves, text_hash(text))
    for target, content in ((path, text.encode()), (picture, png)):
        with atomic_write(target) as draft:
            draft.write_bytes(content)


@command(
    epilog="\b\nExample: unbend profile mission.yaml --plot air.png\n"
    "or: unbend profile --atmosphere us1976 --step 1000"
)
def profile(
    answer: Answer,
    config: Annotated[Path | None, Argument(help="a mission file", metavar="[CONFIG]")] = None,
    atmosphere: Annotated[str | None, Option(help="name of a standard atmosphere")] = None,
    csv: Annotated[Path | None, Option(help="write the profile as CSV")] = None,
    plot: Annotated[Path | None, Option(help="plot of it, .png or .svg")] = None,
    *,
    step: Annotated[
        float | None,
        Option(min=1, max=10_000, help="metres between rows; by default the layers' edges"),
    ] = None,
) -> None:
    """The air of a mission or of a standard: a table, CSV or plot."""
    require_one_atmosphere(config, atmosphere)
    with answer.progress("estimating the air"):
        from unbend.atmosphere.profile import heights_every
        from unbend.batch.runs import air_of_mission_or_standard
        from unbend.report.air_and_rays import print_air, print_profile
        from unbend.tables.manifest.results import EffectRecord
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
            from unbend.report.command_plots import profile_figure, save_figure

            save_figure(profile_figure(air, samples), plot)
    if csv is None and plot is None:
        print_profile(answer.console, rows.to_pylist(), adjustment.standard.name)
    print_air(answer.console, air)
    effects = [asdict(EffectRecord.of(effect)) for effect in air.effects]
    answer.end({"profile": rows.to_pylist(), "effect": effects}, ledger, csv, plot)


def require_one_atmosphere(config: Path | None, atmosphere: str | None) -> None:
    """Refuse (PROFILE-ARGUMENTS) unless exactly one of mission and standard atmosphere is given."""
    if (config is None) == (atmosphere is None):
        raise messages.one_atmosphere_wanted()
