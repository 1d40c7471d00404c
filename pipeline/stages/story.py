"""The story, in order: what becomes of a mission between its log and its folder of results.

Read from top to bottom. Nothing is computed here; every step is a call into the room that knows.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipeline.atmosphere import standard_atmosphere
from pipeline.atmosphere.air_samples import AirSamples
from pipeline.atmosphere.estimate.adjusted_profile import unadjusted
from pipeline.atmosphere.series.profile_series import ProfileSeries, TimedProfile, constant_series
from pipeline.batch.manifest import Outcome, outcome_of
from pipeline.batch.plan import Plan, check_unchanged, make_plan
from pipeline.batch.store import (
    RunFolder,
    find_damage,
    open_folder,
    read_manifest,
    translated,
    written_whole,
)
from pipeline.config import Mission, load_mission
from pipeline.errors import ConfigError, StorageError
from pipeline.flight.air_samples import air_samples
from pipeline.flight.heights import HeightSystem, ground_offsets
from pipeline.flight.stations import Stations, doubt_heights
from pipeline.ledger import Ledger
from pipeline.refraction.effect import FlightAir
from pipeline.refraction.ray import rays_by
from pipeline.report.accuracy import Accuracy, accuracy_page, accuracy_png, text_hash
from pipeline.report.html import write_report
from pipeline.report.progress import NoProgress, Progress
from pipeline.stages.adjusted_profile import adjust_air, find_sources
from pipeline.stages.correction import Recipe, correct_stream
from pipeline.stages.exposure_setup import cameras_of_mission, look_through
from pipeline.stages.finished_run import rebuild_run, refuse_output
from pipeline.stages.ground import Ground
from pipeline.stages.outputs import manifest_of, write_tables
from pipeline.stages.stations import Found, find_stations, open_inputs, read_flight
from pipeline.stages.statistics import Tally
from pipeline.stages.uncertainty import (
    scale_of_block,
    tell_what_is_unknown,
    uncertainties_of_mission,
    views_of_mission,
)
from pipeline.tables.exports import ExportOptions, find_format
from pipeline.tables.observations import Observations
from pipeline.tables.schemas import REFRACTION_APPLIED, REFRACTION_KEY, REFRACTION_REMOVED


def run_mission(path: Path, *, force: bool = False, progress: Progress | None = None) -> Outcome:
    """The main job: one mission, from its file to its folder of results."""
    progress = progress or NoProgress()
    mission = load_mission(path)
    progress.start("hashing the inputs")
    plan = make_plan(mission, path.parent)
    with open_folder(plan.output) as folder:
        earlier = None if force else finished_before(plan)
        if earlier is not None:
            return outcome_of(plan, earlier, repeated=True)
        found = look_at(plan, progress)
        flight, stations, ledger = found.flight, found.stations, found.ledger
        air = adjust_air(mission, stations, found.samples, found.sources, ledger)
        if air.adjustment.is_measured:
            stations = doubt_heights(stations, air.series, ledger)
        progress.start("correcting", found.observations.rows)
        tally = correct(
            mission, stations, air.series, found.observations, folder, ledger,
            flight.heights, progress.advance,
        )  # fmt: skip
        progress.start("writing the report")
        write_tables(folder, stations, air)
        scale = scale_of_block(
            air.adjustment.profile, air.adjustment.covariance, mission.refraction.radius_m, tally
        )
        manifest = manifest_of(plan, flight.log, flight.roles, stations, air, tally, scale, ledger)
        report = folder.place("report.html")
        with translated(report):
            grids = {name: extent.grid for name, extent in tally.extents.items()}
            write_report(report, manifest, air, found.samples, grids)
        folder.seal("report.html")
        check_unchanged(plan)
        manifest["outputs"] = folder.outputs()
        folder.commit(manifest)
    return outcome_of(plan, manifest, repeated=False)


def finished_before(plan: Plan) -> dict[str, Any] | None:
    """The manifest of an earlier run of exactly this, if its results are still there."""
    manifest = read_manifest(plan.output)
    if manifest is None or manifest.get("fingerprint") != plan.fingerprint:
        return None
    return None if find_damage(plan.output, manifest, read=False) else manifest


def look_at(plan: Plan, progress: Progress) -> Found:
    """Read the inputs, and find the stations and what was measured of the air."""
    ledger = Ledger()
    progress.start("reading the observations")
    observations = open_inputs(plan, ledger)
    progress.start("reading the log")
    flight = read_flight(plan, ledger)
    stations = find_stations(plan, flight, observations, ledger)
    samples = air_samples(flight.roles, flight.heights, plan.mission.log.max_gap_s, ledger)
    sources = find_sources(plan, stations, samples, ledger, flight.heights.home_h_msl_m)
    ledger.extend(flight.log.ledger)
    return Found(plan, flight, observations, stations, samples, sources, ledger)


def correct(
    mission: Mission,
    stations: Stations,
    air: ProfileSeries,
    observations: Observations,
    folder: RunFolder,
    ledger: Ledger,
    heights: HeightSystem,
    advance: Callable[[int], None],
) -> Tally:
    """The stream of observations through window, air and camera."""
    section, direction = mission.ground, mission.refraction.direction
    offsets = ground_offsets(section.reference, stations, heights)
    ground = Ground(section.constant_m, offsets, section.from_distance, section.sigma_m)
    cameras = cameras_of_mission(mission)
    exposures = look_through(mission, stations, air, ledger)
    tell_what_is_unknown(mission, stations, air, ledger)
    views = views_of_mission(mission, stations, air)
    recipe = Recipe(
        stations.image,
        stations.camera,
        exposures,
        ground,
        cameras,
        tuple(rays_by(profile, mission.refraction.method) for profile in air.profiles),
        air.profile_number,
        direction,
        uncertainties_of_mission(mission, stations, air, exposures, cameras, ground, views),
        views,
    )
    mark = REFRACTION_REMOVED if direction == "remove" else REFRACTION_APPLIED
    metadata = {
        REFRACTION_KEY.decode(): mark.decode(),
        "unbend.mission": mission.mission.name,
        "unbend.pixel_origin": mission.observations.pixel_origin,
        "unbend.ground_reference": section.reference,
    }
    tally = correct_stream(
        observations, recipe, folder, mission.output.batch_rows, metadata, advance
    )
    tally.report_flagged(ledger)
    return tally


def check_mission(path: Path) -> Found:
    """A mission with everything read and found, and nothing corrected or written."""
    return look_at(make_plan(load_mission(path), path.parent), NoProgress())


def air_of_mission(path: Path) -> tuple[FlightAir, AirSamples, Ledger]:
    """The air that a run would use."""
    found = check_mission(path)
    air = adjust_air(found.plan.mission, found.stations, found.samples, found.sources, found.ledger)
    return air, found.samples, found.ledger


def verify_run(path: Path) -> dict[str, Any]:
    """The manifest of a run whose results are whole and unchanged; refuses any other."""
    manifest = read_manifest(path)
    if manifest is None:
        raise StorageError(
            "VERIFY-NO-MANIFEST",
            "there is no manifest: the run never finished here",
            where=str(path),
            remedy="run the mission",
        )
    damage = find_damage(path, manifest)
    if damage:
        raise StorageError(
            "VERIFY-DAMAGED",
            f"{len(damage)} results are damaged\n    " + "\n    ".join(damage),
            where=str(path),
            remedy="run the mission again; finished results are made anew",
        )
    return manifest


def air_of_either(
    config: Path | None, atmosphere: str | None
) -> tuple[FlightAir, AirSamples, Ledger]:
    """The air of a mission, or a standard atmosphere by its name."""
    if config is not None:
        return air_of_mission(config)
    standard = standard_atmosphere(atmosphere or "")
    alone = unadjusted(standard, f"the standard atmosphere {standard.name}")
    return (
        FlightAir(alone, constant_series(TimedProfile(None, standard), 0)),
        AirSamples(),
        Ledger(),
    )


def export_run(
    path: Path, name: str, out: Path, options: ExportOptions, *, force: bool = False
) -> tuple[int, Ledger]:
    """Write a finished run in a format of other programs; rows written, and what was left out."""
    found = find_format(name, out)
    refuse_output(path, out, force=force)
    ledger = Ledger()
    run = rebuild_run(path, verify_run(path), options.ground_height_m, ledger)
    with written_whole(out) as draft:
        rows = found.write(run, options, draft, ledger)
    return rows, ledger


def write_comparison(found: Accuracy, path: Path) -> None:
    """The comparison of the methods as a page, and its picture beside it."""
    if path.suffix.lower() != ".md":
        raise ConfigError(
            "PAGE-FORMAT",
            f"the page is Markdown and ends in .md, not in {path.suffix or 'nothing'}",
            where=str(path),
            remedy="its picture gets the same name with .png",
        )
    picture = path.with_suffix(".png")
    text = accuracy_page(found, picture.name)
    png = accuracy_png(found.drawn, text_hash(text))
    for target, content in ((path, text.encode()), (picture, png)):
        with written_whole(target) as draft:
            draft.write_bytes(content)
