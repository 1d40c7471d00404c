"""What happens to a mission between its log and its results, in order: each step calls a stage."""

import shutil
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.estimate.adjusted_profile import unadjusted
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.batch import store
from unbend.batch.changes import drawn_before, reasons_to_run
from unbend.batch.executors import ALONE, Helpers, Outcome
from unbend.batch.file_hashes import check_unchanged
from unbend.batch.keys import code_of_stages, key_of_drawn, versions
from unbend.batch.object_store import Place
from unbend.batch.plan import (
    Plan,
    fetch_inputs,
    make_plan,
    outcome_of,
    places_named,
    refuse_other_mission,
)
from unbend.batch.publication import Publication, rehearse_place
from unbend.batch.value_cache import keep, recall
from unbend.config.campaign import MissionRef
from unbend.errors import storage_errors
from unbend.flight.heights import heights_at, logged_terrain, undulation_notes
from unbend.flight.outside_air import outside_air_samples
from unbend.flight.stations import Stations, append_unmatched_images, flag_height_misfits
from unbend.flight.trajectory import takeoff_of
from unbend.messages import Ledger
from unbend.refraction.effect import FlightAir
from unbend.report.flown import Flown, flown_of
from unbend.report.html import write_report
from unbend.report.progress import Progress
from unbend.stages import correction, plausibility
from unbend.stages.adjusted_profile import AirSources, adjusted_profiles, read_air_sources
from unbend.stages.cabin_air import with_cabin_air
from unbend.stages.exposure_setup import correction_setup
from unbend.stages.ground_heights import elevation_of_mission, with_terrain
from unbend.stages.inputs import FlightLog, read_log, read_observations
from unbend.stages.multi_image import point_heights
from unbend.stages.multi_image.control import compare_control
from unbend.stages.outputs import manifest_of, observation_metadata, write_tables
from unbend.stages.stations import stations_of_mission
from unbend.stages.statistics import SAMPLED_ROWS, Statistics
from unbend.stages.uncertainty import TYPICAL_ROWS, report_unknown_sigmas, with_uncertainties
from unbend.tables.geodata.elevation import ElevationModel
from unbend.tables.geodata.geoid import package_geoid
from unbend.tables.observations import Observations
from unbend.units import Array


@dataclass(frozen=True, eq=False)
class PreparedMission:
    """A mission before its observations are corrected: its inputs, stations and air."""

    plan: Plan
    flight: FlightLog
    observations: Observations
    stations: Stations
    terrain: ElevationModel | None
    samples: AirSamples
    sources: AirSources
    air: FlightAir
    ledger: Ledger

    def track(self) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """(n,) time [Unix ns], latitude, longitude [rad], height above sea level [m] as logged."""
        track, height = self.flight.track, self.flight.roles.get("height")
        if track is None or height is None:
            none = np.empty(0)
            return np.empty(0, np.int64), none, none, none
        gap_s = self.plan.mission.max_gap_s
        return *track, heights_at(height, track[0], self.flight.heights, gap_s)[0]


@dataclass(frozen=True, eq=False)
class CorrectedMission:
    """A mission after its observations were corrected."""

    prepared: PreparedMission
    stations: Stations
    air: FlightAir
    setup: correction.CorrectionSetup
    statistics: Statistics
    facts: plausibility.Facts
    manifest: dict[str, Any]


def run_mission(
    mission: MissionRef | Path | str,
    *,
    force: bool = False,
    verify_inputs: bool = False,
    helpers: Helpers = ALONE,
    progress: Progress | None = None,
) -> Outcome:
    """Run one mission into its folder of results, unless the same gave these before, or ``force``.

    ``verify_inputs`` reads inputs that seem unchanged too. ``helpers`` make parts of it.
    """
    progress, ref = progress or Progress(), MissionRef.of(mission)
    mission_file = ref.load()
    progress.start("hashing the inputs")
    plan = make_plan(mission_file, ref.folder, verify=verify_inputs)
    with places_named(plan):
        run = run_plan
        if isinstance(plan.output, Place):
            run = partial(run_and_publish, place=plan.output)
        return run(plan, force=force, progress=progress, helpers=helpers)


def run_and_publish(
    plan: Plan, *, place: Place, force: bool, progress: Progress, helpers: Helpers
) -> Outcome:
    """Run a mission in the user's cache, then publish it, or only publish what was made before."""
    before = Publication(place, plan.fingerprint)
    earlier = finished_before(plan, force=force)
    if earlier is not None:
        return outcome_of(plan, earlier, repeated=True)
    rehearse_place(place, writes=True)
    with storage_errors(plan.folder):
        plan.folder.mkdir(parents=True, exist_ok=True)
    lock = store.lock_folder(plan.folder.parent)
    try:
        here = replace(plan, output=plan.folder)
        run = run_plan(here, force=force, progress=progress, helpers=helpers)
        if run.repeated and store.find_damage(plan.folder, run.manifest):
            run = run_plan(here, force=True, progress=progress)
        progress.start("uploading", sum(int(item["bytes"]) for item in run.manifest["outputs"]))
        manifest = before.publish(plan.folder, run.manifest, progress.advance)
        shutil.rmtree(plan.folder, ignore_errors=True)
    finally:
        lock.release()
    return outcome_of(plan, manifest, repeated=False)


def run_plan(plan: Plan, *, force: bool, progress: Progress, helpers: Helpers = ALONE) -> Outcome:
    """Run a mission with its inputs hashed, whose results go to a folder."""
    with ExitStack() as stack:
        folder = stack.enter_context(store.open_folder(plan.folder))
        earlier = finished_before(plan, force=force)
        if earlier is not None:
            return outcome_of(plan, earlier, repeated=True)
        renewed = None if force else renew_report(plan, folder)
        if renewed is not None:
            return outcome_of(plan, renewed, repeated=False)
        # They start now: the log is read in the meantime.
        table, batch_rows = plan.input("observations").path, plan.mission.output.batch_rows
        parts = correction.parts_of(table, batch_rows)
        workers = stack.enter_context(helpers.workers(correction.__name__, parts))
        prepared = prepare_mission(plan, progress)
        observations = prepared.observations
        progress.start("correcting", observations.rows)

        def correct_all(setup: correction.CorrectionSetup) -> Statistics:
            check_unchanged(plan.inputs)
            folder.resume(f"{plan.keys['correction']} {batch_rows}", anew=force)
            return correction.correct_in_slices(
                observations,
                setup,
                correction.PartsOfRun(folder, partial(check_unchanged, plan.inputs, folders=False)),
                workers=workers,
                batch_rows=batch_rows,
                metadata=observation_metadata(plan.mission),
                progress=progress.advance,
            )

        corrected = correct_mission(prepared, correct_all)
        progress.start("writing the report")
        write_tables(folder, corrected.stations, corrected.air)
        drawn = corrected.manifest, drawing_of(corrected)
        manifest = finish_run(plan, folder, *drawn)
        keep(key_of_drawn(plan.keys["correction"], batch_rows), drawn)
    return outcome_of(plan, manifest, repeated=False)


def check_mission(
    mission: MissionRef | Path | str, *, progress: Progress | None = None
) -> CorrectedMission:
    """Rehearse a mission: all that `run_mission` does, on `SAMPLED_ROWS` rows; writes nothing."""
    progress, ref = progress or Progress(), MissionRef.of(mission)
    plan = make_plan(ref.load(), ref.folder)
    if isinstance(plan.output, Path):
        store.rehearse_folder(plan.output)
    finished_before(plan)
    if isinstance(plan.output, Place):
        rehearse_place(plan.output)
    prepared = prepare_mission(plan, progress, SAMPLED_ROWS)
    progress.start("correcting a sample")

    def correct_sample(setup: correction.CorrectionSetup) -> Statistics:
        _, _, statistics = correction.correct_counted(prepared.observations.sampled(), setup)
        return statistics

    corrected = correct_mission(prepared, correct_sample)
    check_unchanged(plan.inputs)
    return corrected


def mission_status(mission: MissionRef | Path | str) -> tuple[Plan, list[str]]:
    """Why `run_mission` would run a mission now, one reason each; nothing is locked or written."""
    ref = MissionRef.of(mission)
    plan = make_plan(ref.load(), ref.folder)
    manifest = store.read_manifest(plan.output, damaged=True)
    refuse_other_mission(plan, manifest)
    if manifest is None:
        return plan, [f"{plan.output} has no results of it"]
    return plan, reasons_to_run(plan, manifest)


def finished_before(plan: Plan, *, force: bool = False) -> dict[str, Any] | None:
    """The manifest of an earlier run of this plan; refuses another mission's, ``force`` or not."""
    manifest = store.read_manifest(plan.output, damaged=force)
    refuse_other_mission(plan, manifest)
    stays = not force and manifest is not None and not reasons_to_run(plan, manifest)
    return manifest if stays else None


def prepare_mission(
    plan: Plan, progress: Progress, most_rows: int | None = None, stations: Stations | None = None
) -> PreparedMission:
    """Read observations (``most_rows``) and log, build the stations, and estimate the air."""
    ledger = Ledger()
    if any(item.place for item in plan.inputs):
        progress.start("copying inputs from object storage")
    fetch_inputs(plan)
    progress.start("reading the observations")
    observations = read_observations(plan, ledger, most_rows)
    progress.start("reading the log")
    flight = read_log(plan, ledger)
    observations = point_heights.with_object_points(plan, observations, flight, ledger)
    terrain = elevation_of_mission(plan, flight.heights, ledger)
    if stations is None:
        stations = stations_of_mission(plan, flight, observations, terrain, ledger)
    else:
        stations = ledger.take(append_unmatched_images(stations, observations.images))
    point_heights.check_object_points(observations, stations, ledger)
    ledger.extend(undulation_notes(flight.heights, stations, package_geoid()))
    samples = ledger.take(
        outside_air_samples(
            flight.air_roles, flight.heights, plan.mission.max_gap_s, flight.own_suspect
        )
    )
    sources = read_air_sources(plan, flight, stations, samples, ledger)
    air = adjusted_profiles(plan.mission, stations, samples, sources, ledger)
    if air.adjustment.is_measured:
        use_suspect = plan.mission.stations.use_suspect
        stations = ledger.take(flag_height_misfits(stations, air.series, use_suspect=use_suspect))
    ledger.extend(flight.log.ledger if flight.log is not None else ())
    return PreparedMission(
        plan, flight, observations, stations, terrain, samples, sources, air, ledger
    )


def correct_mission(
    prepared: PreparedMission, correct: Callable[[correction.CorrectionSetup], Statistics]
) -> CorrectedMission:
    """Correct the observations of a mission, or a sample of them, and say what became of them."""
    mission, air, ledger = prepared.plan.mission, prepared.air, prepared.ledger
    stations = with_cabin_air(
        prepared.stations, mission.windows, mission.lenses, air.series, ledger
    )
    report_unknown_sigmas(mission, stations, air.series, ledger)
    setup = correction_setup(mission, stations, air.series, prepared.flight.heights, ledger)
    setup = with_terrain(setup, prepared.terrain, stations, mission.ground.sigma_m, ledger)
    setup = point_heights.with_intersected_heights(
        mission, prepared.observations, setup, stations, ledger
    )
    batch = next(prepared.observations.batches(TYPICAL_ROWS))
    setup = with_uncertainties(setup, mission, stations, air.series, batch)
    control = compare_control(
        prepared.plan, prepared.observations, setup, stations, prepared.flight.heights,
        ledger=ledger,
    )  # fmt: skip
    statistics = correct(setup)
    facts = plausibility.Facts(
        mission, stations, setup.exposures, setup.cameras, statistics.sampled_rows(),
        air.adjustment, takeoff_of(prepared.track(), prepared.flight.heights.home_h_msl_m),
        logged_terrain(prepared.flight.channels, stations.time_ns), prepared.terrain,
    )  # fmt: skip
    causes = plausibility.causes_of_statuses(facts)
    statistics.report_flagged(ledger, causes)
    plausibility.report_findings(facts, ledger)
    air = replace(air, effects=facts.effects)
    manifest = manifest_of(
        prepared.plan, prepared.flight, stations, air, statistics=statistics, setup=setup,
        causes=causes, ledger=ledger,
    ) | {"control": None if control is None else control.manifest()}  # fmt: skip
    return CorrectedMission(prepared, stations, air, setup, statistics, facts, manifest)


def drawing_of(corrected: CorrectedMission) -> Flown:
    """What the report draws, beside its manifest."""
    prepared, setup = corrected.prepared, corrected.setup
    return flown_of(
        corrected.stations, corrected.air, prepared.samples, prepared.track(),
        cameras=setup.cameras,
        ground_m=corrected.statistics.ground_of_stations(len(corrected.stations)),
        radius_m=setup.exposures.radius_m,
        terrain=prepared.terrain,
    )  # fmt: skip


def finish_run(
    plan: Plan, folder: store.RunFolder, manifest: dict[str, Any], flown: Flown
) -> dict[str, Any]:
    """Write the report, and last the manifest, with the outputs, which makes the run finished."""
    report = folder.place("report.html")
    with storage_errors(report):
        write_report(report, manifest, flown)
    folder.seal("report.html")
    check_unchanged(plan.inputs)
    manifest = manifest | {"outputs": folder.outputs()}
    folder.commit(manifest)
    return manifest


def renew_report(plan: Plan, folder: store.RunFolder) -> dict[str, Any] | None:
    """Write only the report anew, where nothing before it changed; else None."""
    earlier, keys = store.read_manifest(plan.folder, damaged=True), plan.keys
    if earlier is None or earlier.get("keys", {}).get("correction") != keys["correction"]:
        return None
    damage = store.find_damage(plan.folder, earlier, read=False)
    known = recall(drawn_before(earlier))
    if known is None or any(not line.startswith("report.html: ") for line in damage):
        return None
    before, flown = known
    manifest: dict[str, Any] = before | {
        "fingerprint": plan.fingerprint,
        "keys": keys,
        "code": code_of_stages(),
        "config": plan.mission.model_dump(mode="json"),
        "versions": versions(plan.libraries),
    }
    manifest["config"]["output"]["batch_rows"] = earlier["config"]["output"]["batch_rows"]
    for item in earlier["outputs"]:
        if item["name"] != "report.html":
            folder.leave(item)
    return finish_run(plan, folder, manifest, flown)


def read_mission(mission: MissionRef | Path) -> PreparedMission:
    """A mission with everything read, its stations built and its air estimated."""
    ref = MissionRef.of(mission)
    return prepare_mission(make_plan(ref.load(), ref.folder), Progress())


def air_of_mission_or_standard(
    config: Path | None, atmosphere: str | None
) -> tuple[FlightAir, AirSamples, Ledger]:
    """The air of a mission, or a standard atmosphere by its name."""
    if config is not None:
        prepared = read_mission(config)
        return prepared.air, prepared.samples, prepared.ledger
    standard = standard_atmosphere(atmosphere or "")
    adjustment = unadjusted(standard, f"the standard atmosphere {standard.name}")
    air = FlightAir(adjustment, constant_series(TimedProfile(None, standard), 0))
    return air, AirSamples(), Ledger()
