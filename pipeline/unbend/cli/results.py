"""Commands on the results of a run: export, report and verify."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import cache
from inspect import Parameter, Signature
from math import inf
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option
from typer.core import TyperCommand

from unbend.cli.app import Answer, HelpContext, HelpFormatter, command
from unbend.report.words import count


@cache
def _format_parameters() -> tuple[Any, ...]:
    """Parameters of ``unbend export`` for formats, as typer has them: --format, and their options.

    An option that several formats have is one parameter.
    """
    from unbend.tables.exports import FORMATS

    options = {}
    for form in FORMATS.values():
        for option in form.options:
            options[option.name] = option
    format_option = Option(
        "--format", help="name of a format, see below", autocompletion=lambda: list(FORMATS)
    )
    hints: dict[str, Any] = {"format_name": Annotated[str, format_option]}
    parameters = [Parameter("format_name", Parameter.KEYWORD_ONLY)]
    for option in options.values():
        unit = f" {option.unit}" if option.unit else ""
        hints[option.name] = Annotated[
            option.kind | None,
            Option(
                min=None if option.minimum == -inf else option.kind(option.minimum),
                max=None if option.maximum == inf else option.kind(option.maximum),
                help=f"{option.help}, by default {option.default}{unit}",
            ),
        ]
        parameters.append(Parameter(option.name, Parameter.KEYWORD_ONLY, default=None))

    def stand_in() -> None:
        """Never called: typer makes parameters from its signature."""

    stand_in.__annotations__ = hints
    stand_in.__signature__ = Signature(  # type: ignore[attr-defined]
        [p.replace(annotation=hints[p.name]) for p in parameters]
    )
    command = typer.Typer(add_completion=False, rich_markup_mode=None)
    command.command()(stand_in)
    return tuple(typer.main.get_command(command).params)


class _ExportCommand(TyperCommand):
    """`unbend export` with the options of the formats, which are imported only when it is used."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters of the command, then those of the formats, then --help."""
        command_count = len(self.params)  # those of `export`; super() appends --help
        params = super().get_params(ctx)
        quiet = not {"-q", "--quiet"}.isdisjoint(sys.argv)
        with Answer(quiet=quiet, as_json="--json" in sys.argv).progress("loading"):
            _format_parameters()
        return [*params[:command_count], *_format_parameters(), *params[command_count:]]

    def format_options(self, ctx: HelpContext, formatter: HelpFormatter) -> None:
        """Write the options, and below them the formats with what each writes."""
        from unbend.tables.exports import FORMATS

        super().format_options(ctx, formatter)
        names_by_contents: dict[str, list[str]] = {}  # two for a table: as Parquet and as CSV
        for form in FORMATS.values():
            names_by_contents.setdefault(form.contents, []).append(form.name)
        rows = [(", ".join(names), contents) for contents, names in names_by_contents.items()]
        with formatter.section("Formats"):
            formatter.write_dl(rows)

    def invoke(self, ctx: Any) -> Any:
        """Call the function of the command with the formats' parameters as a mapping, `ctx.obj`."""
        ctx.obj = {p.name: ctx.params.pop(p.name) for p in _format_parameters()}
        return super().invoke(ctx)


@command(
    cls=_ExportCommand,
    epilog="Example: unbend export results/survey --format lattice --out grid.parquet",
)
def export(
    answer: Answer,
    ctx: typer.Context,
    run: Annotated[str, Argument(help="a folder of results, or their URL", metavar="RUN")],
    out: Annotated[Path, Option(help="the file to write, or the folder for several files")],
    ground_height: Annotated[
        float | None,
        Option(help="metres above sea level; by default the median of each image's observations"),
    ] = None,
    crs: Annotated[
        str,
        Option(
            metavar="EPSG:CODE",
            help="coordinate system of opk, points and geopackage: EPSG:25832, or with heights "
            "EPSG:25832+5773",
        ),
    ] = "",
    geoid: Annotated[
        Path | None,
        Option(help="grid of the heights in the vertical part of --crs, .gtx or GeoTIFF"),
    ] = None,
    *,
    force: Annotated[bool, Option(help="replace the file if it exists")] = False,
) -> None:
    """Write the results of a run for other programs.

    The file NAME.unbend.json next to it states its frame: coordinate system, axes, angles, heights.
    """
    options = {name: value for name, value in ctx.obj.items() if value is not None}
    name = options.pop("format_name")
    with answer.progress(f"exporting {run}") as bar:
        from unbend.batch.finished_run.export import ExportSystem, export_run
        from unbend.batch.plan import located

        written = export_run(
            located(run),
            name,
            out,
            options,
            system=ExportSystem(crs, geoid),
            ground_height_m=ground_height,
            force=force,
            progress=bar,
        )
    answer.print_paths([f"{out}: {count(written.rows, 'row')}"])
    content = {"out": str(out), "format": name, "rows": written.rows, "frame": written.frame}
    answer.end(content, written.ledger)


@command(epilog="Example: unbend report results/survey --pdf")
def report(
    answer: Answer,
    run: Annotated[str, Argument(help="a folder of results, or their URL", metavar="RUN")],
    out: Annotated[
        Path | None, Option(help="the file to write; by default NAME-report.html or .pdf, here")
    ] = None,
    *,
    pdf: Annotated[bool, Option("--pdf", help="print it with Chromium, Chrome or Edge")] = False,
    browser: Annotated[
        str | None, Option(help="the browser for printing, a name or a path", metavar="PROGRAM")
    ] = None,
    timeout: Annotated[
        float, Option(min=1.0, max=3600.0, help="largest time for the browser, seconds")
    ] = 120.0,
    force: Annotated[bool, Option(help="replace the file if it exists")] = False,
) -> None:
    """Write the report of a run as a page or PDF to hand over.

    It states when the run was processed. Title, client, operator, remarks and time zone are keys
    of `mission` in the mission file.
    """
    with answer.progress(f"writing the report of {run}"):
        from unbend.batch.finished_run.delivered_report import deliver_report
        from unbend.batch.plan import located

        written, ledger = deliver_report(
            located(run), out, pdf=pdf, browser=browser, timeout_s=timeout, force=force
        )
    answer.end({"out": str(written)}, ledger, written)


@command(epilog="Example: unbend verify results/survey")
def verify(
    answer: Answer,
    run: Annotated[str, Argument(help="a folder of results, or their URL", metavar="RUN")],
    *,
    remove_leftovers: Annotated[
        bool,
        Option(
            "--remove-leftovers", help="of a URL: remove the files that interrupted runs left there"
        ),
    ] = False,
    recent: Annotated[
        bool, Option("--recent", help="with it: also uploads of the last hour, if no run is active")
    ] = False,
) -> None:
    """Check whether the results of a run are complete and unchanged.

    With --remove-leftovers, the URL may contain many results. All folders below it are checked
    too, also without a finished run. Results are not changed.
    """
    content: dict[str, Any] = {}
    with answer.progress(f"hashing {run}"):
        from unbend.batch import remote
        from unbend.batch.plan import located
        from unbend.batch.results import read_manifest, verify_run

        output = located(run)
        has_results = True  # else only leftovers were removed
        if remove_leftovers and isinstance(output, remote.Place):
            removed, young = remote.remove_leftovers(output, recent=recent)
            print_leftovers(answer, removed, young)
            content = {"removed": removed, "kept": young}
            has_results = read_manifest(output) is not None
        manifest = verify_run(output) if has_results else None
    if manifest is None:
        answer.print_json(content)
        return
    files = len(manifest.run.outputs)
    verb = "is" if files == 1 else "are"
    mission = manifest.run.mission
    answer.print_paths([f"{run}: {count(files, 'file')} of mission {mission} {verb} whole"])
    answer.print_json(
        content | {"run": str(run), "mission": mission, "files": files, "whole": True}
    )


def print_leftovers(answer: Answer, removed: Sequence[str], young: int) -> None:
    """Print the removed leftovers of interrupted runs, and the number of young ones that stay."""
    answer.print_paths(f"removed {name}" for name in removed)
    if young:
        uploads = count(young, "upload")
        answer.console.print(f"{uploads} of the last hour kept: --recent also removes them")
    elif not removed:
        answer.console.print("nothing is left of interrupted runs")
