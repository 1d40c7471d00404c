"""The story, in order: what becomes of a mission between its log and its folder of results.

Read from top to bottom. Nothing is computed here; every step is a call into the room that knows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from pipeline.atmosphere import Profile, standard_atmosphere
from pipeline.atmosphere.adjust import (
    Adjustment,
    build_adjusted_profile,
    unadjusted,
    under_gravity,
)
from pipeline.atmosphere.air import IndexModel
from pipeline.atmosphere.samples import AirSamples
from pipeline.batch.correct import CameraSetup, Ground, Recipe, Tally, correct_stream
from pipeline.batch.look import (
    exposures_of,
    tell_of_lenses,
    tell_of_windows,
    warn_of_calibration,
)
from pipeline.batch.manifest import Outcome, manifest_of, outcome_of
from pipeline.batch.plan import Plan, check_unchanged, make_plan
from pipeline.batch.results import (
    check_reproduced,
    ground_of,
    mission_of,
    parts_of,
    profile_of,
    refuse_output,
    stations_of,
    written_whole,
)
from pipeline.batch.store import (
    RunFolder,
    find_damage,
    open_folder,
    read_manifest,
    translated,
)
from pipeline.config import Mission, load_mission
from pipeline.errors import ConfigError, MissionError, StorageError
from pipeline.flight.air import air_samples
from pipeline.flight.channels import Channel
from pipeline.flight.exposures import (
    Events,
    account_for_triggers,
    build_stations,
    choose_event_channel,
    events_of_channel,
    events_of_table,
    refuse_repeated_images,
    require_aircraft_attitude,
    require_cabin_air,
)
from pipeline.flight.heights import HeightSystem, ground_offsets, height_system
from pipeline.flight.local import locate
from pipeline.flight.quality import within_reason
from pipeline.flight.roles import Wish, assign_roles, warn_of_gimbal
from pipeline.flight.stations import (
    Stations,
    doubt_heights,
    join_stations,
    name_the_unmatched,
    report_flagged,
)
from pipeline.ingest import Log, open_log
from pipeline.ledger import Ledger
from pipeline.refraction.image import Exposures
from pipeline.refraction.ray import rays_by
from pipeline.report.accuracy import Accuracy, accuracy_page, text_hash
from pipeline.report.accuracy_figure import accuracy_png
from pipeline.report.html import write_report
from pipeline.report.progress import Progress, Silent
from pipeline.tables.events import EventColumns, read_events
from pipeline.tables.exports import ExportCamera, ExportOptions, FinishedRun, find_format
from pipeline.tables.observations import Observations, open_observations
from pipeline.tables.schemas import REFRACTION_APPLIED, REFRACTION_KEY, REFRACTION_REMOVED
from pipeline.tables.writing import profile_arrow, stations_table, write_parquet

PROFILE_ID = "flight"


@dataclass(frozen=True, eq=False)
class Flight:
    """A log after its channels were given their roles."""

    log: Log
    channels: tuple[Channel, ...]
    roles: dict[str, Channel]
    heights: HeightSystem


@dataclass(frozen=True, eq=False)
class Found:
    """What is known of a mission before anything is corrected."""

    plan: Plan
    flight: Flight
    observations: Observations
    stations: Stations
    samples: AirSamples
    ledger: Ledger

    def lines(self) -> list[tuple[str, str]]:
        """For a person."""
        roles = ", ".join(
            f"{role.replace('_', ' ')} {channel.name}"
            for role, channel in sorted(self.flight.roles.items())
        )
        cameras = Counter(self.stations.camera[self.stations.ok].tolist())
        return [
            ("log", f"{self.plan.mission.log.path}: {self.flight.log.format}"),
            ("channels", roles),
            ("stations", ", ".join(f"{n} of {name}" for name, n in cameras.items()) or "none"),
            (
                "observations",
                f"{self.observations.rows:,} in {len(self.observations.images)} images",
            ),
            ("results", str(self.plan.output)),
        ]


def run_mission(path: Path, *, force: bool = False, progress: Progress | None = None) -> Outcome:
    """The main job: one mission, from its file to its folder of results."""
    progress = progress or Silent()
    mission = load_mission(path)
    progress.say("hashing the inputs")
    plan = make_plan(mission, path.parent)
    with open_folder(plan.output) as folder:
        earlier = None if force else finished_before(plan)
        if earlier is not None:
            return outcome_of(plan, earlier, repeated=True)
        found = look_at(plan, progress)
        flight, stations, ledger = found.flight, found.stations, found.ledger
        adjustment = adjust_air(mission, stations, found.samples, ledger)
        if adjustment.basis != "standard":
            stations = doubt_heights(stations, adjustment.profile, ledger)
        progress.begin("correcting", found.observations.rows)
        tally = correct(
            mission, stations, adjustment.profile, found.observations, folder, ledger,
            flight.heights, progress.advance,
        )  # fmt: skip
        progress.say("writing the report")
        write_tables(folder, stations, adjustment)
        manifest = manifest_of(plan, flight.log, flight.roles, stations, adjustment, tally, ledger)
        report = folder.place("report.html")
        with translated(report):
            grids = {name: extent.grid for name, extent in tally.extents.items()}
            write_report(report, manifest, adjustment, found.samples, grids)
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
    progress.say("reading the observations")
    observations = open_inputs(plan, ledger)
    progress.say("reading the log")
    flight = read_flight(plan, ledger)
    stations = find_stations(plan, flight, observations, ledger)
    samples = air_samples(flight.roles, flight.heights, plan.mission.log.max_gap_s, ledger)
    ledger.extend(flight.log.ledger)
    return Found(plan, flight, observations, stations, samples, ledger)


def open_inputs(plan: Plan, ledger: Ledger) -> Observations:
    """The table of observations, checked."""
    section, ground = plan.mission.observations, plan.mission.ground
    return open_observations(
        plan.input("observations").path,
        section.columns.model_dump(),
        ground.column,
        ledger,
        ground_is_msl=ground.reference == "msl",
        direction=plan.mission.refraction.direction,
    )


def read_flight(plan: Plan, ledger: Ledger) -> Flight:
    """The log, its channels in their roles, and how its heights go together."""
    section = plan.mission.log
    file = plan.input("log")
    log = open_log(file.path, file.sha256)
    channels = log.channels
    if section.local_origin is not None:
        origin = section.local_origin.build()
        channels = tuple(locate(channel, origin) for channel in channels)
    wishes = {role: Wish(c.name, c.unit) for role, c in section.channels.named().items()}
    roles = assign_roles(channels, wishes, ledger, needs_cabin=reads_cabin(plan.mission))
    sound = {role: within_reason(channel, role, ledger) for role, channel in roles.items()}
    warn_of_gimbal(log.messages, ledger)
    heights = height_system(sound, plan.mission.mission.undulation_m, ledger)
    stated_home = plan.mission.ground.home_h_msl_m
    if stated_home is not None:
        heights = replace(heights, home_h_msl_m=stated_home)
    return Flight(log, channels, sound, heights)


def reads_cabin(mission: Mission) -> bool:
    """Whether a window or a lens takes its cabin air from the log."""
    return any(camera.needs_cabin_from_log for camera in mission.cameras.values())


def find_events(plan: Plan, channels: tuple[Channel, ...], ledger: Ledger) -> list[Events]:
    """When each camera was exposed, from the log or from a table."""
    section = plan.mission.events
    if section.log is not None:
        found = []
        for camera, how in section.log.items():
            channel = choose_event_channel(channels, how.channel)
            account_for_triggers(channels, channel, ledger)
            found.append(events_of_channel(channel, camera, how.image, how.delay_s, ledger))
        return found
    csv = section.csv
    if csv is None:
        raise MissionError("EVENTS-NONE", "the mission names no events", where="events")
    table = read_events(plan.input("events").path, EventColumns(**csv.columns.model_dump()), ledger)
    only = csv.camera or next(iter(plan.mission.cameras))
    camera_of = table.camera if table.camera is not None else np.full(table.image.shape, only)
    for name in sorted(set(camera_of.tolist()) - set(plan.mission.cameras)):
        raise MissionError(
            "EVENTS-CAMERA",
            f"the table of exposures speaks of camera {name!r}",
            where=str(csv.path),
            remedy=f"cameras are {', '.join(plan.mission.cameras)}",
        )
    return [
        events_of_table(table.image, camera_of, table.time_ns, camera, csv.delay_s)
        for camera in plan.mission.cameras
    ]


def find_stations(
    plan: Plan, flight: Flight, observations: Observations, ledger: Ledger
) -> Stations:
    """One row an exposure: position, attitude and air, or the reason why not."""
    mission = plan.mission
    events = find_events(plan, flight.channels, ledger)
    refuse_repeated_images(events)
    parts = [
        build_stations(
            event,
            flight.roles,
            mission.mount[event.camera].build(),
            flight.heights,
            mission.log.max_gap_s,
        )
        for event in events
    ]
    stations = join_stations(parts)
    for name, camera in mission.cameras.items():
        if camera.needs_cabin_from_log:
            stations = require_cabin_air(stations, name, ledger)
        if camera.window is not None and camera.window.frame == "body":
            stations = require_aircraft_attitude(stations, name, ledger)
    stations = name_the_unmatched(stations, observations.images, ledger)
    report_flagged(stations, ledger)
    return stations


def adjust_air(
    mission: Mission, stations: Stations, samples: AirSamples, ledger: Ledger
) -> Adjustment:
    """The locally adjusted profile of the flight, or the standard where the user wants that."""
    section = mission.atmosphere
    index = IndexModel(section.index, section.wavelength_m, section.co2_ppm)
    standard = replace(standard_atmosphere(section.standard), index=index)
    if not section.adjust:
        ledger.note("AIR-NOT-ADJUSTED", "atmosphere.adjust is false: the standard is kept")
        standard = under_gravity(standard, stations.mean_latitude_rad)
        return unadjusted(standard, "atmosphere.adjust is false: the standard is kept")
    return build_adjusted_profile(samples, standard, stations.mean_latitude_rad, ledger)


def correct(
    mission: Mission,
    stations: Stations,
    profile: Profile,
    observations: Observations,
    folder: RunFolder,
    ledger: Ledger,
    heights: HeightSystem,
    advance: Callable[[int], None],
) -> Tally:
    """The stream of observations through window, air and camera."""
    ground = mission.ground
    offsets = ground_offsets(ground.reference, stations, heights)
    direction = mission.refraction.direction
    recipe = Recipe(
        stations.image,
        stations.camera,
        look_through(mission, stations, profile, ledger),
        Ground(ground.constant_m, offsets, ground.from_distance),
        {name: setup_of(mission, name) for name in mission.cameras},
        rays_by(profile, mission.refraction.method),
        direction,
    )
    mark = REFRACTION_REMOVED if direction == "remove" else REFRACTION_APPLIED
    metadata = {
        REFRACTION_KEY.decode(): mark.decode(),
        "unbend.mission": mission.mission.name,
        "unbend.pixel_origin": mission.observations.pixel_origin,
        "unbend.ground_reference": ground.reference,
    }
    tally = correct_stream(
        observations, recipe, folder, mission.output.batch_rows, metadata, advance
    )
    tally.report_flagged(ledger)
    return tally


def look_through(
    mission: Mission, stations: Stations, profile: Profile, ledger: Ledger
) -> Exposures:
    """What the rays of each exposure need to know: attitude, and the air beside the window."""
    for name, camera in mission.cameras.items():
        warn_of_calibration(name, camera.calibration, ledger)
    cameras = mission.cameras.items()
    windows = {name: camera.window.build() for name, camera in cameras if camera.window}
    lenses = {name: lens for name, camera in cameras if (lens := camera.lens()) is not None}
    tell_of_windows(windows, ledger)
    tell_of_lenses(mission.cameras, lenses, ledger)
    return exposures_of(stations, profile, windows, lenses, mission.refraction.radius_m, ledger)


def setup_of(mission: Mission, name: str) -> CameraSetup:
    """Interior orientation, and what takes the user's pixels to COLMAP's."""
    observed = mission.observations
    return CameraSetup(mission.cameras[name].build(observed.pixel_origin), observed.offset_px)


def write_tables(folder: RunFolder, stations: Stations, adjustment: Adjustment) -> None:
    """Stations and profile beside the observations."""
    for name, table in (
        ("stations.parquet", stations_table(stations, PROFILE_ID)),
        ("profile.parquet", profile_arrow(adjustment, PROFILE_ID)),
    ):
        write_parquet(table, folder.place(name))
        folder.seal(name)


def check_mission(path: Path) -> Found:
    """A mission with everything read and found, and nothing corrected or written."""
    return look_at(make_plan(load_mission(path), path.parent), Silent())


def profile_of_mission(path: Path) -> tuple[Adjustment, AirSamples, Ledger]:
    """The profile of the air that a run would use."""
    found = check_mission(path)
    adjustment = adjust_air(found.plan.mission, found.stations, found.samples, found.ledger)
    return adjustment, found.samples, found.ledger


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


def profile_sources(
    config: Path | None, atmosphere: str | None
) -> tuple[Adjustment, AirSamples, Ledger]:
    """The profile of a mission, or a standard atmosphere by its name."""
    if config is not None:
        return profile_of_mission(config)
    standard = standard_atmosphere(atmosphere or "")
    return unadjusted(standard, f"the standard atmosphere {standard.name}"), AirSamples(), Ledger()


def export_run(
    path: Path, name: str, out: Path, options: ExportOptions, *, force: bool = False
) -> tuple[int, Ledger]:
    """Write a finished run in a format of other programs; rows written, and what was left out."""
    found = find_format(name, out)
    refuse_output(path, out, force=force)
    ledger = Ledger()
    run = rebuild_run(path, options.ground_height_m, ledger)
    with written_whole(out) as draft:
        rows = found.write(run, options, draft, ledger)
    return rows, ledger


def rebuild_run(path: Path, ground_height_m: float | None, ledger: Ledger) -> FinishedRun:
    """A run as it was, from its folder alone; refuses one that does not come out the same."""
    manifest = verify_run(path)
    mission = mission_of(manifest, path)
    stations = stations_of(pq.read_table(path / "stations.parquet"))
    profile = profile_of(pq.read_table(path / "profile.parquet"))
    parts = parts_of(manifest, path)
    constant = None if ground_height_m is None else np.full(len(stations), ground_height_m)
    run = FinishedRun(
        mission.mission.name,
        stations,
        look_through(mission, stations, profile, Ledger()),
        profile,
        rays_by(profile, mission.refraction.method),
        mission.refraction.method,
        {name: export_camera(mission, name) for name in mission.cameras},
        ground_of(parts, stations, ledger) if constant is None else constant,
        parts,
        {
            "unbend.mission": mission.mission.name,
            "unbend.fingerprint": manifest["fingerprint"],
            "unbend.pixel_origin": mission.observations.pixel_origin,
        },
    )
    check_reproduced(run, path)
    return run


def export_camera(mission: Mission, name: str) -> ExportCamera:
    """A camera as exports need it."""
    setup = setup_of(mission, name)
    window = mission.cameras[name].window
    windowed = window is not None and window.shape == "plane"
    return ExportCamera(setup.camera, setup.pixel_offset, windowed)


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
