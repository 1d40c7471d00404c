"""Commands on missions and logs."""

from __future__ import annotations

import sys
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from typer import Argument, Option

from unbend.cli import messages
from unbend.cli.app import Answer, command, print_bug, print_error, write_rows_csv
from unbend.errors import UnbendError
from unbend.exit_codes import EXIT_BUG, EXIT_DONE, exit_code_of
from unbend.messages import Kind
from unbend.report.words import count

if TYPE_CHECKING:
    from unbend.batch.campaigns import Selection
    from unbend.batch.execute import MissionEnd
    from unbend.config.campaign import MissionRef
    from unbend.report.message_csv import Columns


Configs = Annotated[
    list[Path], Argument(help="mission files and campaign files", metavar="CONFIG...")
]
Names = Annotated[
    list[str] | None, Option("--mission", help="only this mission of a campaign, by name or file")
]


@command(epilog="Example: unbend run configs/*.yaml; unbend run season.yaml --jobs 2")
def run(
    answer: Answer,
    configs: Configs,
    jobs: Annotated[
        int, Option(min=1, help="number of processes, that is, of missions at the same time")
    ] = 1,
    force: Annotated[bool, Option(help="run even if nothing has changed")] = False,
    names: Names = None,
    *,
    verify_inputs: Annotated[
        bool, Option(help="also read and hash inputs with unchanged size and time")
    ] = False,
    shard: Annotated[
        str | None,
        Option(
            metavar="K/N",
            help=(
                "only part K of N of the missions, counted from 0: 0/8 to 7/8 for an array of "
                "eight jobs"
            ),
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        Option(
            metavar="ADDRESS", help="run on the workers of a Dask scheduler (tcp://... or its file)"
        ),
    ] = None,
) -> None:
    """Correct missions. A refused mission does not stop the others.

    For a campaign, campaign.html and campaign.parquet show all its missions. With --shard they
    are not written.
    """
    if scheduler is not None and jobs > 1:
        raise messages.jobs_and_scheduler()
    with answer.progress("loading"):
        if scheduler is not None:
            from unbend.batch.dask_executor import refuse_missing

            refuse_missing(scheduler)
        from unbend.batch.campaigns import select_missions, write_pages
        from unbend.batch.execute import shard_of

        chosen = select_missions(configs, names or (), shard_of(shard))
    entries: dict[MissionRef, dict[str, Any]] = {}
    ended: dict[MissionRef, MissionEnd] = {}
    in_other_processes = jobs > 1 or scheduler is not None  # then missions have no bars
    title = f"{len(chosen.missions)} missions"
    run_in_executor = partial(
        run_missions,
        answer,
        jobs=jobs,
        scheduler=scheduler,
        force=force,
        verify_inputs=verify_inputs,
    )
    ends = chosen.ends(run_in_executor, run_unchanged=force or verify_inputs)
    with answer.progress(title) if in_other_processes else nullcontext(), closing(ends):
        for ref, end in ends:
            ended[ref] = end
            entries[ref] = print_end(answer, ref.label, end, chosen)
    print_repeated(answer, chosen, ended)
    if shard is None:
        answer.print_paths(str(page) for page in write_pages(chosen, ended))
    in_order = [entries[ref] for ref in chosen.missions if ref in entries]
    end_of_command(answer, in_order)


def run_missions(
    answer: Answer,
    missions: list[MissionRef],
    *,
    jobs: int,
    scheduler: str | None,
    force: bool,
    verify_inputs: bool,
) -> Generator[tuple[MissionRef, MissionEnd]]:
    """Run missions; yields how each ended, as soon as it did.

    They run on the workers of a ``scheduler`` (its address), else for more than one of ``jobs`` in
    as many other processes, else in this process. ``force`` and ``verify_inputs`` are those of
    `run_mission`.
    """
    with answer.progress("loading"):
        from unbend.batch.campaigns import run_chosen
        from unbend.batch.execute import run_many
        from unbend.batch.executors import Executor, Inline

    executor: Executor = Inline(answer.progress)
    ref_of_sent = {ref: ref for ref in missions}  # by the reference that is sent to the executor
    if scheduler is not None:
        from unbend.batch.dask_executor import DaskExecutor

        executor = DaskExecutor(scheduler)
        ref_of_sent = {replace(ref, path=ref.path.absolute()): ref for ref in missions}
    elif jobs > 1 and len(missions) > 1:
        from unbend.batch.processes import Processes

        executor = Processes(jobs)
    task = partial(run_chosen, force=force, verify_inputs=verify_inputs)
    with closing(run_many(task, list(ref_of_sent), executor)) as ends:
        for sent_ref, end in ends:
            yield ref_of_sent[sent_ref], end


def print_end(answer: Answer, config: str, end: MissionEnd, chosen: Selection) -> dict[str, Any]:
    """Print how a mission ended, and return its entry in the JSON of the command.

    ``config`` is the label of the mission. Among several missions nothing is printed here for an
    unchanged one, and in a campaign only one line for any other.
    """
    from unbend.batch.executors import Bug
    from unbend.batch.results import read_manifest

    if isinstance(end, UnbendError):
        return print_refused(config, end)
    if isinstance(end, Bug):
        print_bug(end.traceback, config)
        return {"config": config, "exit_code": EXIT_BUG}
    is_one_of_several = len(chosen.missions) > 1
    if end.manifest is not None and not (end.repeated and is_one_of_several):
        from unbend.report.terminal import print_run

        print_run(
            answer.console,
            end.name,
            str(end.output),
            end.manifest,
            repeated=end.repeated,
            brief=is_one_of_several and bool(chosen.campaigns),
        )
    entry: dict[str, Any] = {
        "config": config,
        "output": str(end.output),
        "repeated": end.repeated,
        "exit_code": end.exit_code,
    }
    if answer.as_json:
        manifest = end.manifest or read_manifest(end.output)
        entry["manifest"] = None if manifest is None else manifest.values
    return entry


def print_repeated(
    answer: Answer, chosen: Selection, ended: Mapping[MissionRef, MissionEnd]
) -> None:
    """Print which missions were unchanged, in the order of the files; nothing for one mission."""
    from unbend.batch.executors import Outcome
    from unbend.report.terminal import print_unchanged

    repeated = []
    for ref in chosen.missions:
        end = ended.get(ref)
        if isinstance(end, Outcome) and end.repeated:
            repeated.append(end.name)
    if repeated and len(chosen.missions) > 1:
        print_unchanged(answer.console, repeated, len(chosen.missions))


def print_refused(config: str, error: UnbendError) -> dict[str, Any]:
    """Print the refusal of a mission, and return its entry in the JSON of the command."""
    print_error(error, config)
    refusal = {
        "code": error.code,
        "what": error.what,
        "where": error.where,
        "to_do": error.remedy,
    }
    return {"config": config, "exit_code": error.exit_code, "refusal": refusal}


def end_of_command(answer: Answer, entries: Sequence[Mapping[str, Any]]) -> NoReturn:
    """Print the entries of the missions if JSON is wanted, and exit with the command's code."""
    from unbend.batch.execute import exit_code_of_command

    answer.print_json(entries)
    raise typer.Exit(exit_code_of_command([int(entry["exit_code"]) for entry in entries]))


@command(epilog="Example: unbend check mission.yaml")
def check(
    answer: Answer,
    configs: Configs,
    names: Names = None,
    *,
    verbose: Annotated[
        bool, Option("--verbose", "-v", help="show the notes of the ledger too")
    ] = False,
) -> None:
    """Rehearse `run` on a sample: its messages and exit code.

    Writes nothing.
    """
    with answer.progress("loading"):
        from unbend.batch.campaigns import select_missions
        from unbend.batch.rehearsal import input_lines, rehearsal_lines
        from unbend.batch.runs import check_mission
        from unbend.report.terminal import print_check

        chosen = select_missions(configs, names or ())
    entries: list[dict[str, Any]] = []
    for ref in chosen.missions:
        try:
            if ref in chosen.refused:
                raise chosen.refused[ref]
            with answer.progress(f"checking {ref.path.name}") as bar:
                checked = check_mission(ref, progress=bar)
                lines = [*input_lines(checked), *rehearsal_lines(checked)]
        except UnbendError as error:
            entries.append(print_refused(ref.label, error))
            continue
        results = checked.manifest.results
        print_check(answer.console, ref.label, lines, results, verbose=verbose)
        entry = {
            "config": ref.label,
            "exit_code": results.exit_code,
            "lines": dict(lines),
            "manifest": checked.manifest.values,
        }
        entries.append(entry)
    end_of_command(answer, entries)


@command(epilog="Example: unbend status configs/*.yaml")
def status(answer: Answer, configs: Configs, names: Names = None) -> None:
    """List the missions that `run` would run now, and why.

    Names the inputs, keys, libraries and results that changed since the last run.
    """
    with answer.progress("loading"):
        from unbend.batch.campaigns import select_missions
        from unbend.report.terminal import print_status

        chosen = select_missions(configs, names or (), writes=False)
    entries: list[dict[str, Any]] = []
    for ref in chosen.missions:
        try:
            output, reasons = status_of(answer, ref, chosen)
        except UnbendError as error:
            entries.append(print_refused(ref.label, error))
            continue
        if reasons or not chosen.campaigns:
            print_status(answer.console, ref.label, reasons)
        entry = {
            "config": ref.label,
            "output": output,
            "would_run": bool(reasons),
            "reasons": reasons,
            "exit_code": EXIT_DONE,
        }
        entries.append(entry)
    would_run = sum(entry.get("would_run", False) for entry in entries)
    answer.console.print(f"{count(would_run, 'mission')} of {len(chosen.missions)} would run")
    end_of_command(answer, entries)


def status_of(answer: Answer, ref: MissionRef, chosen: Selection) -> tuple[str, list[str]]:
    """Where the results of a mission go, and why it would run; no reasons if it would not run."""
    if chosen.is_unchanged(ref):
        return str(chosen.named[ref].output), []
    with answer.progress(f"looking at {ref.path.name}"):
        from unbend.batch.runs import mission_status

        plan, reasons = mission_status(ref)
    return str(plan.output), reasons


@command(epilog="Example: unbend stations mission.yaml --plot flight.png")
def stations(
    answer: Answer,
    config: Annotated[Path, Argument(help="a mission file", metavar="CONFIG")],
    csv: Annotated[Path | None, Option(help="write all stations as CSV")] = None,
    plot: Annotated[
        Path | None, Option(help="plot of the flight with its stations, .png or .svg")
    ] = None,
) -> None:
    """Stations of a mission, events assigned to images, and a plot."""
    with answer.progress(f"reading {config.name}"):
        from unbend.batch.runs import read_mission
        from unbend.report.terminal import print_stations
        from unbend.tables.writing import rows_of_stations

        prepared = read_mission(config)
        rows = rows_of_stations(prepared.stations)
    if csv is not None:
        write_rows_csv(csv, rows)
    if plot is not None:
        with answer.progress(f"drawing {plot.name}"):
            from unbend.report.command_plots import flight_figure, save_figure

            suspect = [(stretch.begin_ns, stretch.end_ns) for stretch in prepared.flight.suspect]
            save_figure(flight_figure(prepared.stations, prepared.track(), suspect), plot)
    print_stations(answer.console, rows)
    about_stations = ("EVENTS-", "EXIF-", "IMAGES-", "STATIONS-", "SUSPECT-")
    shown = []
    for entry in prepared.ledger.records():
        if entry.kind != Kind.NOTE or entry.code.startswith(about_stations):
            shown.append(entry)
    answer.end({"stations": rows}, prepared.ledger, csv, plot, shown=shown)


@command(epilog="Example: unbend inspect flight.bin; unbend inspect flight.bin --type BARO --csv")
def inspect(
    answer: Answer,
    log: Annotated[
        Path,
        Argument(
            help="a flight log, a file of a weather model (netCDF, GRIB), a sounding, or a text of "
            "METARs",
            metavar="LOG",
        ),
    ],
    kind: Annotated[str | None, Option("--type", help="all messages of one type or topic")] = None,
    instance: Annotated[str | None, Option(help="with --type: only this instance")] = None,
    as_csv: Annotated[bool, Option("--csv", help="with --type: every row, as CSV")] = False,
) -> None:
    """Show how a log, a sounding, METARs or a weather model is read."""
    if (kind is None and (as_csv or instance is not None)) or (as_csv and answer.as_json):
        raise messages.inspect_options()
    with answer.progress(f"reading {log.name}"):
        from unbend.ingest import open_log

        # Reading a pipe might never end: `open_log` refuses it.
        may_be_weather = kind is None and log.is_file()
        if may_be_weather and (print_weather(answer, log) or print_weather_model(answer, log)):
            raise typer.Exit(EXIT_DONE)
        opened = open_log(log, needs_channels=kind is None)
        columns = None if kind is None else opened.message(kind, instance)
    if columns is not None:
        print_messages(answer, columns, log=log.name, kind=kind, as_csv=as_csv)
    elif answer.as_json:
        answer.print_json(opened.to_json_dict())
    elif not answer.quiet:
        from unbend.report.inspected_log import print_log

        print_log(answer.console, opened.to_json_dict(), log.name)
    raise typer.Exit(exit_code_of(has_losses=opened.ledger.has_losses))


def print_messages(
    answer: Answer,
    columns: Columns,
    *,
    log: str,
    kind: str | None,
    as_csv: bool,
) -> None:
    """Print the messages of one kind: each row as CSV, or a summary of their fields.

    ``columns`` are the values by field, ``log`` is the name of the log's file.
    """
    if as_csv:
        if not answer.quiet:
            from unbend.report.message_csv import write_messages_csv

            write_messages_csv(sys.stdout, columns)
        return
    from unbend.report.inspected_log import print_fields
    from unbend.report.message_csv import field_rows

    fields = field_rows(columns)
    rows = len(next(iter(columns.values())))
    answer.print_json({"type": kind, "rows": rows, "fields": fields})
    print_fields(answer.console, f"{log}, {kind}", fields)


def print_weather_model(answer: Answer, path: Path) -> bool:
    """Print what a file of a weather model contains; returns False for any other file."""
    from unbend.tables.weather_files import contents_of, is_model_file

    if not is_model_file(path):
        return False
    contents = contents_of(path)
    if answer.as_json:
        answer.print_json(contents)
    elif not answer.quiet:
        from unbend.report.inspected_weather import print_model

        print_model(answer.console, contents, path.name)
    return True


def print_weather(answer: Answer, path: Path) -> bool:
    """Print how a sounding or a text of METARs is read; returns False for any other file."""
    from unbend.ingest.registry import is_log
    from unbend.tables.inspected_readings import reading_of_weather

    reading = None if is_log(path) else reading_of_weather(path)
    if reading is None:
        return False
    if answer.as_json:
        answer.print_json(reading)
    elif not answer.quiet:
        from unbend.report.inspected_weather import print_metars, print_sounding

        if reading["kind"] == "sounding":
            print_sounding(answer.console, reading, path.name)
        else:
            print_metars(answer.console, reading["reports"], path.name)
    return True


@command(epilog="Example: unbend simulate flown --height 3000")
def simulate(
    answer: Answer,
    out: Annotated[Path, Argument(help="folder to write to", metavar="OUT")],
    height: Annotated[float, Option(help="metres above ground")] = 3000.0,
    seed: Annotated[int, Option(help="seed of the sensor noise")] = 7,
    noise: Annotated[float, Option(help="noise of the image measurements, pixels")] = 0.0,
) -> None:
    """Fly a survey with known truth: logs, observations, missions.

    The same flight three times, as .bin, .tlog and .mcap, with a mission file for each.
    """
    with answer.progress("simulating") as bar:
        from unbend.simulate import SimulationOptions
        from unbend.simulate import simulate as simulate_flight

        options = SimulationOptions(seed=seed, height_above_ground_m=height, image_noise_px=noise)
        flown = simulate_flight(out, options, bar.update)
    missions = [str(path) for path in flown.missions.values()]
    text = (
        f"{out}: {count(flown.images, 'image')}, {count(flown.observation_count, 'observation')} "
        f"of {count(flown.points, 'point')}, {flown.duration_s:.0f} s of flight in three logs"
    )
    answer.print_paths([text, *(f"  unbend run {path}" for path in missions)])
    answer.print_json(
        {
            "out": str(out),
            "images": flown.images,
            "observations": flown.observation_count,
            "points": flown.points,
            "duration_s": flown.duration_s,
            "missions": missions,
        }
    )
