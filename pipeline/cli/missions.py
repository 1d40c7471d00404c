"""Commands on missions, logs and folders of results."""

from __future__ import annotations

import json
import sys
from contextlib import closing
from functools import cache, partial
from inspect import Parameter, Signature
from math import inf
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from typer.core import TyperCommand

from pipeline.cli.app import app, end_command, new_console, print_bug, print_error, write_rows_csv
from pipeline.errors import EXIT_BUG, EXIT_DONE, EXIT_LOSSES, ConfigError, UnbendError


@app.command(epilog="Example: unbend run configs/*.yaml")
def run(
    configs: Annotated[list[Path], typer.Argument(help="mission files", metavar="CONFIG...")],
    jobs: Annotated[int, typer.Option(min=1, help="missions at the same time")] = 1,
    force: Annotated[bool, typer.Option(help="run even where nothing has changed")] = False,
) -> None:
    """Correct missions; one that is refused does not stop the rest."""
    from pipeline.batch.execute import Bug, exit_code_of, run_many
    from pipeline.report.progress import DelayedProgressBar
    from pipeline.report.terminal import print_run
    from pipeline.stages.story import run_mission

    console = new_console()
    codes: list[int] = []
    run_one = partial(run_mission, force=force)
    outcomes = run_many(run_one, configs, jobs, lambda name: DelayedProgressBar(console, name))
    with closing(outcomes):
        for config, end in outcomes:
            if isinstance(end, UnbendError):
                print_error(end, str(config))
                codes.append(end.exit_code)
            elif isinstance(end, Bug):
                print_bug(end.traceback, str(config))
                codes.append(EXIT_BUG)
            else:
                print_run(console, end.name, str(end.output), end.manifest, repeated=end.repeated)
                codes.append(end.exit_code)
    raise typer.Exit(exit_code_of(codes))


@app.command(epilog="Example: unbend check mission.yaml")
def check(
    configs: Annotated[list[Path], typer.Argument(help="mission files", metavar="CONFIG...")],
) -> None:
    """Rehearse `run` on a sample: all it would say, and its exit code.

    Writes nothing.
    """
    from pipeline.batch.execute import exit_code_of, shared_outputs
    from pipeline.report.progress import DelayedProgressBar
    from pipeline.report.terminal import print_check
    from pipeline.stages.rehearsal import input_lines, rehearsal_lines
    from pipeline.stages.story import check_mission

    console = new_console()
    codes: list[int] = []
    shared = shared_outputs(configs)
    for config in configs:
        try:
            if config in shared:
                raise shared[config]
            with DelayedProgressBar(console, f"checking {config.name}") as bar:
                checked = check_mission(config, progress=bar)
                lines = [*input_lines(checked), *rehearsal_lines(checked)]
        except UnbendError as error:
            print_error(error, str(config))
            codes.append(error.exit_code)
            continue
        print_check(console, str(config), lines, checked.manifest)
        codes.append(int(checked.manifest["exit_code"]))
    raise typer.Exit(exit_code_of(codes))


@app.command(epilog="Example: unbend stations mission.yaml --plot flight.png")
def stations(
    config: Annotated[Path, typer.Argument(help="a mission file", metavar="CONFIG")],
    csv: Annotated[Path | None, typer.Option(help="write all stations as CSV")] = None,
    plot: Annotated[
        Path | None, typer.Option(help="draw the flight with its stations, .png or .svg")
    ] = None,
) -> None:
    """Stations of a mission, how events became images, and a drawing."""
    from pipeline.report.progress import DelayedProgressBar
    from pipeline.report.terminal import print_ledger, print_stations
    from pipeline.stages.story import read_mission
    from pipeline.tables.writing import rows_of_stations

    console = new_console()
    with DelayedProgressBar(console, f"reading {config.name}"):
        checked = read_mission(config)
    table = rows_of_stations(checked.stations)
    if csv is not None:
        write_rows_csv(csv, table)
    if plot is not None:
        from pipeline.report.figures import flight_figure, save_figure

        suspect = [(stretch.begin_ns, stretch.end_ns) for stretch in checked.flight.suspect]
        save_figure(flight_figure(checked.stations, checked.track(), suspect), plot)
    print_stations(console, table)
    about = ("EVENTS-", "EXIF-", "IMAGES-", "STATIONS-", "SUSPECT-")
    rows = checked.ledger.rows()
    shown = [e for e in rows if e["kind"] != "note" or str(e["code"]).startswith(about)]
    print_ledger(console, shown)
    for path in filter(None, (csv, plot)):
        console.print(escape(str(path)), soft_wrap=True)
    raise typer.Exit(EXIT_LOSSES if checked.ledger.has_losses else EXIT_DONE)


@app.command(
    epilog="Example: unbend inspect flight.bin; unbend inspect flight.bin --type BARO --csv"
)
def inspect(
    log: Annotated[Path, typer.Argument(help="a flight log", metavar="LOG")],
    as_json: Annotated[bool, typer.Option("--json", help="everything, as JSON")] = False,
    kind: Annotated[
        str | None, typer.Option("--type", help="all messages of one type or topic")
    ] = None,
    instance: Annotated[str | None, typer.Option(help="with --type: only this instance")] = None,
    as_csv: Annotated[bool, typer.Option("--csv", help="with --type: every row, as CSV")] = False,
) -> None:
    """Show what a log holds, by the names that a mission file uses."""
    from pipeline.ingest import open_log
    from pipeline.report.messages import field_rows, write_messages_csv
    from pipeline.report.progress import DelayedProgressBar
    from pipeline.report.terminal import print_fields, print_log

    if (kind is None and (as_csv or instance is not None)) or (kind is not None and as_json):
        what = "--csv and --instance go with --type, --json goes without it"
        remedy = "for example: unbend inspect flight.bin --type BARO --csv"
        raise ConfigError("INSPECT-ARGUMENTS", what, remedy=remedy)
    console = new_console()
    with DelayedProgressBar(console, f"reading {log.name}"):
        opened = open_log(log, needs_channels=kind is None)
        columns = None if kind is None else opened.message(kind, instance)
    if columns is not None and as_csv:
        write_messages_csv(sys.stdout, columns)
    elif columns is not None:
        print_fields(console, f"{log.name}, {kind}", field_rows(columns))
    elif as_json:
        print(json.dumps(opened.to_json_dict(), indent=2, allow_nan=False))
    else:
        print_log(console, opened.to_json_dict(), log.name)
    raise typer.Exit(EXIT_LOSSES if opened.ledger.has_losses else EXIT_DONE)


@cache
def _format_parameters() -> tuple[Any, ...]:
    """Parameters of ``unbend export`` that the formats declare: --format, and their options."""
    from pipeline.tables.exports import FORMATS

    names: dict[str, list[str]] = {}
    for form in FORMATS.values():
        names.setdefault(form.contents, []).append(form.name)
    listed = "; ".join(f"{', '.join(of)}: {contents}" for contents, of in names.items())
    hints: dict[str, Any] = {"format_name": Annotated[str, typer.Option("--format", help=listed)]}
    parameters = [Parameter("format_name", Parameter.KEYWORD_ONLY)]
    for option in {o.name: o for form in FORMATS.values() for o in form.options}.values():
        unit = f" {option.unit}" if option.unit else ""
        hints[option.name] = Annotated[
            option.kind | None,
            typer.Option(
                min=None if option.minimum == -inf else option.kind(option.minimum),
                max=None if option.maximum == inf else option.kind(option.maximum),
                help=f"{option.help}, by default {option.default}{unit}",
            ),
        ]
        parameters.append(Parameter(option.name, Parameter.KEYWORD_ONLY, default=None))

    def declared() -> None:
        """Only its parameters are used."""

    declared.__annotations__ = hints
    declared.__signature__ = Signature(  # type: ignore[attr-defined]
        [p.replace(annotation=hints[p.name]) for p in parameters]
    )
    command = typer.Typer(add_completion=False, rich_markup_mode=None)
    command.command()(declared)
    return tuple(typer.main.get_command(command).params)


class _ExportCommand(TyperCommand):
    """`unbend export`, with the options of the formats; they are imported when it is used."""

    def get_params(self, ctx: Any) -> list[Any]:
        own = len(self.params)
        params = super().get_params(ctx)
        return [*params[:own], *_format_parameters(), *params[own:]]

    def invoke(self, ctx: Any) -> Any:
        """Hand the function of the command what the formats declare as one mapping."""
        ctx.obj = {p.name: ctx.params.pop(p.name) for p in _format_parameters()}
        return super().invoke(ctx)


@app.command(
    cls=_ExportCommand,
    epilog="Example: unbend export results/survey --format lattice --out grid.parquet",
)
def export(
    ctx: typer.Context,
    run: Annotated[Path, typer.Argument(help="a folder of results", metavar="RUN")],
    out: Annotated[Path, typer.Option(help="the file to write, or the folder that several go to")],
    ground_height: Annotated[
        float | None,
        typer.Option(
            help="metres above sea level; by default the median of each image's observations"
        ),
    ] = None,
    force: Annotated[bool, typer.Option(help="replace the file if it is there")] = False,
) -> None:
    """Write the results of a run for other programs."""
    from pipeline.report.progress import DelayedProgressBar
    from pipeline.stages.story import export_run

    console = new_console()
    options = {name: value for name, value in ctx.obj.items() if value is not None}
    name = options.pop("format_name")
    with DelayedProgressBar(console, f"exporting {run.name}"):
        written, ledger = export_run(
            run, name, out, options, ground_height_m=ground_height, force=force
        )
    console.print(f"{escape(str(out))}: {written:,} rows")
    end_command(console, ledger)


@app.command(epilog="Example: unbend simulate flown --height 3000")
def simulate(
    out: Annotated[Path, typer.Argument(help="folder to write to", metavar="OUT")],
    height: Annotated[float, typer.Option(help="metres above ground")] = 3000.0,
    seed: Annotated[int, typer.Option(help="of the sensor noise")] = 7,
    noise: Annotated[float, typer.Option(help="of the image measurements, pixels")] = 0.0,
) -> None:
    """Fly a survey with known truth: logs, observations, missions.

    The same flight three times, as .bin, .tlog and .mcap, with a mission file for each.
    """
    from pipeline.report.progress import DelayedProgressBar
    from pipeline.simulate import SimulationOptions
    from pipeline.simulate import simulate as simulate_flight

    console = new_console()
    options = SimulationOptions(seed=seed, height_above_ground_m=height, image_noise_px=noise)
    with DelayedProgressBar(console, "simulating") as bar:
        flown = simulate_flight(out, options, bar.update)
    console.print(
        f"{escape(str(out))}: {flown.images} images, {flown.observation_count:,} observations of "
        f"{flown.points:,} points, {flown.duration_s:.0f} s of flight in three logs"
    )
    for path in flown.missions.values():
        console.print(f"  unbend run {escape(str(path))}")


@app.command(epilog="Example: unbend verify results/survey")
def verify(run: Annotated[Path, typer.Argument(help="a folder of results", metavar="RUN")]) -> None:
    """Whether the results of a run are whole and unchanged."""
    from pipeline.stages.story import verify_run

    manifest = verify_run(run)
    new_console().print(
        f"{escape(str(run))}: {len(manifest['outputs'])} files of mission "
        f"{escape(str(manifest['mission']))} are whole"
    )
