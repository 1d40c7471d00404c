"""Words to one call each; errors to exit codes.

Exit codes: 0 done; 1 a bug; 2 command or mission file; 3 done, but data was lost, damaged or
flagged, or something the mission file names is absent; 4 output folder in use; 5 storage failure,
or verify found damage; 6 a mission was refused, the others are done; 130, 143 interrupted.
"""

from __future__ import annotations

import csv as csv_module
import json
import os
import signal
import sys
import traceback
from contextlib import closing
from functools import partial
from pathlib import Path
from types import FrameType, TracebackType
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.markup import escape

import pipeline
from pipeline.errors import (
    EXIT_BUG,
    EXIT_CONFIG,
    EXIT_DONE,
    EXIT_INTERRUPTED,
    EXIT_LOSSES,
    ConfigError,
    UnbendError,
)

app = typer.Typer(
    name="unbend",
    help="Removes atmospheric refraction from aerial image observations, with the air the "
    "aircraft measured.",
    epilog=__doc__.split("\n\n", 1)[1],
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


# The root of what a mistaken command line raises: click's class, or that of the copy of click
# that newer versions of typer carry.
_USAGE_ERROR: type[Exception] = typer.BadParameter.__bases__[0]


class _Console(Console):
    """A console that leaves it to `main` what a reader who went away means."""

    def on_broken_pipe(self) -> NoReturn:
        """Let it through; rich would leave with the code of a bug."""
        raise BrokenPipeError


def _console() -> Console:
    return _Console(soft_wrap=False, highlight=False)


def _refuse(error: UnbendError, subject: str = "") -> None:
    print(f"{subject}: {error}" if subject else error, file=sys.stderr)


@app.command(epilog="Example: unbend run configs/*.yaml")
def run(
    configs: Annotated[list[Path], typer.Argument(help="mission files", metavar="CONFIG...")],
    jobs: Annotated[int, typer.Option(min=1, help="missions at the same time")] = 1,
    force: Annotated[bool, typer.Option(help="run even where nothing has changed")] = False,
) -> None:
    """Correct missions; one that is refused does not stop the rest."""
    from pipeline.batch.execute import Bug, exit_code_of, run_many
    from pipeline.report.progress import PatientBar
    from pipeline.report.terminal import show_run
    from pipeline.stages import run_mission

    console = _console()
    ends: list[int] = []
    one = partial(run_mission, force=force)
    with closing(run_many(one, configs, jobs, lambda name: PatientBar(console, name))) as running:
        for config, end in running:
            if isinstance(end, UnbendError):
                _refuse(end, str(config))
                ends.append(end.exit_code)
                continue
            if isinstance(end, Bug):
                _own_up(end.traceback, str(config))
                ends.append(EXIT_BUG)
                continue
            show_run(console, end.name, str(end.output), end.manifest, repeated=end.repeated)
            ends.append(end.exit_code)
    raise typer.Exit(exit_code_of(ends))


@app.command(epilog="Example: unbend check mission.yaml")
def check(
    configs: Annotated[list[Path], typer.Argument(help="mission files", metavar="CONFIG...")],
) -> None:
    """Validate mission files and their inputs; correct nothing."""
    from pipeline.batch.execute import exit_code_of
    from pipeline.report.progress import PatientBar
    from pipeline.report.terminal import show_check, show_ledger
    from pipeline.stages import check_mission

    console = _console()
    ends: list[int] = []
    for config in configs:
        try:
            with PatientBar(console, f"checking {config.name}"):
                found = check_mission(config)
        except UnbendError as error:
            _refuse(error, str(config))
            ends.append(error.exit_code)
            continue
        console.print(f"[bold]{escape(str(config))}[/bold] can be run")
        show_check(console, found.lines())
        show_ledger(console, found.ledger.rows())
        ends.append(EXIT_LOSSES if found.ledger.has_losses else EXIT_DONE)
    raise typer.Exit(exit_code_of(ends))


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
    """Show what a log holds, in the words that a mission file takes."""
    from pipeline.ingest import open_log
    from pipeline.report.columns import field_rows, write_csv
    from pipeline.report.progress import PatientBar
    from pipeline.report.terminal import show_fields, show_log

    if (kind is None and (as_csv or instance is not None)) or (kind is not None and as_json):
        raise ConfigError(
            "INSPECT-ARGUMENTS",
            "--csv and --instance go with --type, --json goes without it",
            remedy="for example: unbend inspect flight.bin --type BARO --csv",
        )
    console = _console()
    with PatientBar(console, f"reading {log.name}"):
        opened = open_log(log)
        columns = None if kind is None else opened.message(kind, instance)
    if columns is not None and as_csv:
        write_csv(sys.stdout, columns)
    elif columns is not None:
        show_fields(console, f"{log.name}, {kind}", field_rows(columns))
    elif as_json:
        print(json.dumps(opened.to_json_dict(), indent=2))
    else:
        show_log(console, opened.to_json_dict(), log.name)
    raise typer.Exit(EXIT_LOSSES if opened.ledger.has_losses else EXIT_DONE)


_METHODS = (
    "spherical, plane, gyer1996, saastamoinen1974, saastamoinen1974_ican, "
    "saastamoinen1974_quadratic, saastamoinen1974_weather, saastamoinen1974_series, bertram1966, "
    "manual"
)


@app.command(
    epilog="Example: unbend angle --atmosphere us1976 --index gyer --camera-height 10000 "
    "--ground-height 0 --nadir-angle 75"
)
def angle(
    camera_height: Annotated[float, typer.Option(help="metres above sea level")],
    ground_height: Annotated[float, typer.Option(help="metres above sea level")],
    nadir_angle: Annotated[float, typer.Option(help="apparent nadir angle, degrees, 0 to 180")],
    atmosphere: Annotated[str, typer.Option(help="name of a standard atmosphere")] = "us1976",
    method: Annotated[str, typer.Option(help=_METHODS)] = "spherical",
    index: Annotated[str, typer.Option(help="ciddor or gyer (Eq. 13)")] = "ciddor",
    radius: Annotated[float, typer.Option(help="radius of the earth, metres")] = 6_371_000.0,
    as_json: Annotated[bool, typer.Option("--json", help="as JSON")] = False,
) -> None:
    """One refraction angle, in arcsec, microradians and metres on the ground."""
    from pipeline.refraction.angle import one_angle
    from pipeline.report.terminal import show_angle

    result = one_angle(atmosphere, index, camera_height, ground_height, nadir_angle, radius, method)
    if as_json:
        print(json.dumps(result, indent=2))
    else:
        show_angle(_console(), result)


@app.command(epilog="Example: unbend tables gyer1996 --csv gyer.csv")
def tables(
    paper: Annotated[
        str, typer.Argument(help="gyer1996, saastamoinen1974 or bertram1966", metavar="PAPER")
    ],
    csv: Annotated[Path | None, typer.Option(help="write the rows as CSV")] = None,
) -> None:
    """Recompute a paper's tables: as printed, as published, and exact."""
    from pipeline.refraction.papers import paper_tables
    from pipeline.report.terminal import show_paper

    table = paper_tables(paper)
    if csv is None:
        show_paper(_console(), table.rows(), table.notes)
    else:
        _write_csv(csv, table.rows())


@app.command(
    epilog="Example: unbend profile mission.yaml --plot air.png; "
    "unbend profile --atmosphere us1976 --step 1000"
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
    """The profile of the air, of a mission or of a standard, as a table, CSV or plot."""
    from pipeline.atmosphere.profile import heights_every
    from pipeline.report.progress import PatientBar
    from pipeline.stages import profile_sources
    from pipeline.tables.writing import profile_arrow

    if (config is None) == (atmosphere is None):
        raise ConfigError(
            "PROFILE-ARGUMENTS",
            "give a mission file, or --atmosphere",
            remedy="for example: unbend profile --atmosphere us1976",
        )
    console = _console()
    with PatientBar(console, "finding the air"):
        adjustment, samples, ledger = profile_sources(config, atmosphere)
    heights = None if step is None else heights_every(adjustment.profile, step)
    table = profile_arrow(adjustment, "", heights).drop_columns(["profile_id", "time_utc"])
    rows = table.to_pylist()
    if csv is not None:
        _write_csv(csv, rows)
    if plot is not None:
        from pipeline.report.figures import profile_figure, save_figure

        save_figure(profile_figure(adjustment, samples), plot)
    if csv is None and plot is None:
        from pipeline.report.terminal import show_ledger, show_profile

        show_profile(console, rows)
        show_ledger(console, ledger.rows())
    raise typer.Exit(EXIT_LOSSES if ledger.has_losses else EXIT_DONE)


def _write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    from pipeline.batch.store import translated

    with translated(path), path.open("w", newline="", encoding="utf-8") as file:
        writer = csv_module.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


@app.command(epilog="Example: unbend simulate flown --height 3000")
def simulate(
    out: Annotated[Path, typer.Argument(help="folder to write to", metavar="OUT")],
    height: Annotated[float, typer.Option(help="metres above ground")] = 3000.0,
    seed: Annotated[int, typer.Option(help="of the sensor noise")] = 7,
    noise: Annotated[float, typer.Option(help="of the image measurements, pixels")] = 0.0,
) -> None:
    """Fly a survey with known truth: three logs, observations, mission files and the truth."""
    from pipeline.report.progress import PatientBar
    from pipeline.simulate import SimulationOptions
    from pipeline.simulate import simulate as fly

    console = _console()
    options = SimulationOptions(seed=seed, height_above_ground_m=height, image_noise_px=noise)
    with PatientBar(console, "simulating") as bar:
        flown = fly(out, options, bar.show)
    console.print(
        f"{escape(str(out))}: {flown.images} images, {flown.observation_count:,} observations of "
        f"{flown.points:,} points, {flown.duration_s:.0f} s of flight in three logs"
    )
    for path in flown.missions.values():
        console.print(f"  unbend run {escape(str(path))}")


@app.command(epilog="Example: unbend verify results/survey")
def verify(
    run: Annotated[Path, typer.Argument(help="a folder of results", metavar="RUN")],
) -> None:
    """Whether the results of a run are whole and unchanged."""
    from pipeline.stages import verify_run

    manifest = verify_run(run)
    _console().print(
        f"{escape(str(run))}: {len(manifest['outputs'])} files of mission "
        f"{escape(str(manifest['mission']))} are whole"
    )


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="print the version")] = False,
) -> None:
    if version:
        print(f"unbend {pipeline.__version__}")
        raise typer.Exit


def _terminated(_: int, __: FrameType | None) -> None:
    raise SystemExit(143)


def _own_up(text: str, subject: str = "") -> None:
    """Say that an error is ours, with all that is needed to find it."""
    where = f"{subject}: " if subject else ""
    print(f"{text}\n{where}this is a bug in unbend: please report the lines above", file=sys.stderr)


def _unexpected(kind: type[BaseException], error: BaseException, at: TracebackType | None) -> None:
    """What Python calls for an exception that nothing caught; it then leaves with exit code 1."""
    _own_up("".join(traceback.format_exception(kind, error, at)))


def _obey(words: list[str]) -> int:
    """Run one command; its exit code.

    typer's own main would turn a bug, Ctrl-C and a broken pipe into codes and words of its own.
    """
    command = typer.main.get_command(app)
    try:
        with command.make_context("unbend", words) as context:
            command.invoke(context)
    except typer.Exit as end:
        return end.exit_code
    return EXIT_DONE


def main() -> None:
    """Run the command line and leave with its exit code."""
    sys.excepthook = _unexpected
    signal.signal(signal.SIGTERM, _terminated)
    code = EXIT_DONE
    try:
        code = _obey(sys.argv[1:])
        sys.stdout.flush()
    except UnbendError as error:
        _refuse(error)
        code = error.exit_code
    except (typer.Abort, KeyboardInterrupt):
        print("interrupted; run again to finish", file=sys.stderr)
        code = EXIT_INTERRUPTED
    except _USAGE_ERROR as error:
        error.show()  # type: ignore[attr-defined]
        code = EXIT_CONFIG
    except BrokenPipeError:
        # Whoever read our words has gone; what is still buffered must not complain at the exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = EXIT_INTERRUPTED
    sys.exit(code)


__all__ = ["app", "main"]
