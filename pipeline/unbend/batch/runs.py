"""A mission is run into its folder: locked, hashed, resumed, published; rehearsed; looked at."""

import shutil
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.estimate.adjusted_profile import unadjusted
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.batch import messages, opening, remote, store
from unbend.batch.differences import reasons_to_run
from unbend.batch.executors import Outcome
from unbend.batch.input_files import Input
from unbend.batch.plan import Plan, fetch_inputs, make_plan, places_named, refuse_other_mission
from unbend.batch.remote import Place
from unbend.batch.results import read_manifest
from unbend.batch.run_files import PartsOfRun, correct_into, write_tables
from unbend.batch.unchanged import load
from unbend.config import Mission
from unbend.config.campaign import MissionRef
from unbend.config.reading import folder_of
from unbend.errors import StorageError, storage_errors
from unbend.messages import Ledger, MessageRecord
from unbend.refraction.effect import FlightAir
from unbend.report.figure_data import Flown, flown_of
from unbend.report.progress import Progress
from unbend.report.report_page import write_report
from unbend.stages.correction import correct_counted
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.results import observation_metadata
from unbend.stages.statistics import SAMPLED_ROWS, Statistics
from unbend.stages.story import CorrectedMission, PreparedMission, correct_mission, prepare_mission
from unbend.stages.wavelengths import in_light, refuse_fixed_wavelength
from unbend.tables.manifest.file_names import REPORT
from unbend.tables.manifest.whole import Manifest

AnyMission: TypeAlias = MissionRef | Mission | Path | str
"""A mission by its file or its place in a campaign, or as `load_mission` gives it."""


def run_mission(
    mission: AnyMission,
    *,
    force: bool = False,
    verify_inputs: bool = False,
    progress: Progress | None = None,
) -> Outcome:
    """Run one mission, unless an earlier run has made the results that it would make.

    ``mission`` is a mission file, or what `load_mission` gives, which may have been changed since.
    ``force`` runs the mission in any case. With ``verify_inputs`` an input is read and hashed even
    if its size and time are those that it had in the earlier run.
    """
    progress = progress or Progress()
    progress.start("hashing the inputs")
    plan = plan_of(mission, verify=verify_inputs)
    with places_named(plan):
        if isinstance(plan.output, Place):
            return run_and_publish(plan, place=plan.output, force=force, progress=progress)
        is_repeated, manifest = run_plan(plan, force=force, progress=progress)
        return outcome_of(plan, manifest, repeated=is_repeated)


def plan_of(mission: AnyMission, *, verify: bool = False) -> Plan:
    """A mission as understood, with its inputs hashed."""
    if isinstance(mission, Mission):
        return make_plan(mission, folder_of(mission), verify=verify)
    ref = MissionRef.of(mission)
    loaded = load(ref)
    return make_plan(loaded.mission, ref.folder, verify=verify, text_sha256=loaded.text_sha256)


def run_and_publish(plan: Plan, *, place: Place, force: bool, progress: Progress) -> Outcome:
    """Run a mission in the user's cache, then publish its results at a place.

    * If the results of this plan are published already, nothing is done (``repeated``).
    * If an earlier command made them in the cache but could not publish them, they are published
      without a run.
    """
    # Made first, because a publication notes what is published now: if another run is published
    # from here on, this one is refused.
    publication = remote.Publication(place, plan.fingerprint)
    earlier = finished_before(plan, force=force)
    if earlier is not None:
        return outcome_of(plan, earlier, repeated=True)
    remote.rehearse(place, writes=True)
    with storage_errors(plan.folder):
        plan.folder.mkdir(parents=True, exist_ok=True)
    # `run_plan` locks the folder for the run alone; this lock lasts until the upload has ended.
    lock = store.lock_folder(plan.folder.parent)
    try:
        plan_in_cache = replace(plan, output=plan.folder)
        was_in_cache, manifest = run_plan(plan_in_cache, force=force, progress=progress)
        if was_in_cache and store.find_damage(plan.folder, manifest):
            # `run_plan` trusts files by their times. An upload has to be whole by its content.
            _, manifest = run_plan(plan_in_cache, force=True, progress=progress)
        size = sum(output.bytes for output in manifest.run.outputs)
        progress.start("uploading", size)
        published = publication.publish(plan.folder, manifest, progress.advance)
        shutil.rmtree(plan.folder, ignore_errors=True)
    finally:
        lock.release()
    # Not repeated, even if an earlier command made the results: this one published them.
    return outcome_of(plan, published, repeated=False)


def run_plan(plan: Plan, *, force: bool, progress: Progress) -> tuple[bool, Manifest]:
    """Run a mission with its inputs hashed, whose results go to a folder.

    Returns whether an earlier run had made these results, so that nothing ran now; and the manifest
    of the results.
    """
    with store.open_folder(plan.folder) as folder:
        earlier = finished_before(plan, force=force)
        if earlier is not None:
            return True, renewed(plan, folder, earlier)
        prepared = prepare(plan, progress)
        observations = prepared.observations
        batch_rows = plan.mission.output.batch_rows
        progress.start("correcting", observations.rows)

        def correct_all(setup: CorrectionSetup) -> Statistics:
            """Correct all observations into the folder; keep parts of an interrupted equal run."""
            plan.check_unchanged()
            folder.resume(f"{plan.fingerprint} {batch_rows}", anew=force)
            return correct_into(
                PartsOfRun(folder, partial(plan.check_unchanged, folders=False)),
                observations,
                setup,
                batch_rows=batch_rows,
                metadata=observation_metadata(plan.mission),
                progress=progress.advance,
            )

        corrected = correct_mission(prepared, correct_all)
        progress.start("writing the report")
        write_tables(folder, corrected.stations, corrected.air)
        manifest = manifest_of(plan, corrected)
        return False, finish_run(plan, folder, manifest, drawing_of(corrected))


def prepare(plan: Plan, progress: Progress, most_rows: int | None = None) -> PreparedMission:
    """Open the inputs of a mission, build its stations and estimate its air.

    Only ``most_rows`` of the observations are drawn, to stand for all; None takes all.
    """
    ledger = Ledger()
    mission = plan.mission
    paths = {item.role: item.path for item in plan.inputs}
    hashes = {item.role: item.sha256 for item in plan.inputs}
    if plan.remotes:
        progress.start("copying inputs from object storage")
        fetch_inputs(plan)
    progress.start("reading the observations")
    observations = opening.open_table(mission, paths["observations"], ledger, most_rows)
    progress.start("reading the log")
    log = opening.decode_log(mission, paths, hashes.get("log"))
    inputs = opening.open_inputs(
        mission, paths, observations, log, ledger, camera_names=plan.camera_names
    )
    return prepare_mission(mission, inputs, ledger)


def manifest_of(plan: Plan, corrected: CorrectedMission) -> Manifest:
    """The manifest of a run, without its outputs.

    It holds no host name, no absolute path, and no time but those of the inputs.
    """
    ledger = [renamed(entry, plan.inputs) for entry in corrected.results.ledger]
    results = replace(corrected.results, ledger=ledger)
    return Manifest({**results.row(), **plan.identity().row()})


def renamed(entry: MessageRecord, inputs: Iterable[Input]) -> MessageRecord:
    """A message that names inputs as the mission file does, not by their paths here."""
    where = entry.where
    for item in inputs:
        where = where.replace(str(item.path), item.name)
    return replace(entry, where=where)


def outcome_of(plan: Plan, manifest: Manifest, *, repeated: bool) -> Outcome:
    """How a mission ended, by the manifest of its results."""
    return Outcome(
        name=plan.mission.mission.name,
        output=plan.output,
        manifest=manifest,
        exit_code=manifest.run.exit_code,
        repeated=repeated,
    )


def finished_before(plan: Plan, *, force: bool = False) -> Manifest | None:
    """The manifest of an earlier run that made what the plan would make; None if the plan must run.

    A damaged manifest is refused. With ``force`` it is not, and the plan must run in any case. The
    manifest of another mission is always refused.
    """
    manifest = read_manifest(plan.output, ignore_damaged=force)
    refuse_other_mission(plan, manifest)
    if force or manifest is None or reasons_to_run(plan, manifest):
        return None
    return manifest


def renewed(plan: Plan, folder: store.RunFolder, manifest: Manifest) -> Manifest:
    """The manifest of an unchanged run with sizes and times of its inputs as they are now.

    Where an input, or the mission file, was copied or written again with the same content, the
    next run need not read it. A folder that cannot be written to stays as it is.
    """
    now = plan.identity()
    before = manifest.run
    # A mission that was loaded before does not know the text of its file: what is known stays.
    file_sha256 = now.mission_file_sha256 or before.mission_file_sha256
    if before.inputs == now.inputs and before.mission_file_sha256 == file_sha256:
        return manifest
    values_now = {
        "inputs": [asdict(record) for record in now.inputs],
        "mission_file_sha256": file_sha256,
    }
    manifest_now = manifest.with_values(values_now)
    with suppress(StorageError):
        folder.rewrite_manifest(manifest_now)
    return manifest_now


@dataclass(frozen=True, eq=False)
class CheckedMission:
    """A rehearsed mission, and the manifest that it would have."""

    plan: Plan
    corrected: CorrectedMission
    manifest: Manifest


def check_mission(mission: AnyMission, *, progress: Progress | None = None) -> CheckedMission:
    """Rehearse a mission: all that `run_mission` does, on `SAMPLED_ROWS` rows; writes nothing."""
    progress = progress or Progress()
    plan = plan_of(mission)
    if isinstance(plan.output, Path):
        store.rehearse_folder(plan.output)
    finished_before(plan)  # for its refusals: a rehearsal does not depend on earlier results
    if isinstance(plan.output, Place):
        remote.rehearse(plan.output)
    prepared = prepare(plan, progress, SAMPLED_ROWS)
    progress.start("correcting a sample")

    def correct_sample(setup: CorrectionSetup) -> Statistics:
        _, _, statistics = correct_counted(prepared.observations.sampled(), setup)
        return statistics

    corrected = correct_mission(prepared, correct_sample)
    plan.check_unchanged()
    return CheckedMission(plan, corrected, manifest_of(plan, corrected))


def mission_status(mission: AnyMission) -> tuple[Plan, list[str]]:
    """Why `run_mission` would run a mission now, one reason each; nothing is locked or written."""
    plan = plan_of(mission)
    manifest = read_manifest(plan.output, ignore_damaged=True)
    refuse_other_mission(plan, manifest)
    if manifest is None:
        return plan, [f"{plan.output} has no results of it"]
    return plan, reasons_to_run(plan, manifest)


def drawing_of(corrected: CorrectedMission) -> Flown:
    """What the report draws, beside its manifest."""
    prepared = corrected.prepared
    setup = corrected.setup
    return flown_of(
        corrected.stations,
        corrected.air,
        prepared.samples,
        prepared.track(),
        cameras=setup.cameras,
        ground_m=corrected.statistics.ground_of_stations(len(corrected.stations)),
        radius_m=setup.exposures.radius_m,
        terrain=prepared.terrain,
    )


def finish_run(plan: Plan, folder: store.RunFolder, manifest: Manifest, flown: Flown) -> Manifest:
    """Write the report, and last the manifest with the outputs: with it the run is finished."""
    report = folder.place(REPORT)
    with storage_errors(report):
        write_report(report, manifest, flown)
    folder.seal(REPORT)
    plan.check_unchanged()
    outputs = [asdict(output) for output in folder.outputs()]
    manifest_with_outputs = manifest.with_values({"outputs": outputs})
    folder.commit(manifest_with_outputs)
    return manifest_with_outputs


def read_mission(mission: AnyMission) -> PreparedMission:
    """A mission with everything read, its stations built and its air estimated."""
    return prepare(plan_of(mission), Progress())


def profile_in_light(
    config: Path | None,
    atmosphere: str | None,
    *,
    camera: str | None = None,
    wavelength_m: float | None = None,
) -> tuple[Profile, Ledger]:
    """The profile of a mission, or a standard atmosphere by its name, in one light.

    That is a wavelength in vacuum [m], else the light of one of the mission's cameras, else that of
    the whole mission or standard. Refuses (ConfigError ANGLE-CAMERA) a camera that is not there.
    """
    if config is None:
        profile = standard_atmosphere(atmosphere or "")
        ledger = Ledger()
    else:
        prepared = read_mission(config)
        profile = prepared.air.adjustment.profile
        ledger = prepared.ledger
        cameras = prepared.mission.cameras
        if camera is not None and camera not in cameras:
            raise messages.no_such_camera(where=str(config), name=camera, names=", ".join(cameras))
        if camera is not None and wavelength_m is None:
            wavelength_m = cameras[camera].wavelength_m
    if wavelength_m is None:
        return profile, ledger
    refuse_fixed_wavelength(profile.index, "--wavelength")
    return in_light(TimedProfile(None, profile), wavelength_m).profile, ledger


def air_of_mission_or_standard(
    config: Path | None, atmosphere: str | None
) -> tuple[FlightAir, AirSamples, Ledger]:
    """The air of the mission of ``config`` with its samples and notes.

    Without ``config`` it is the standard atmosphere of that name, which has neither.
    """
    if config is not None:
        prepared = read_mission(config)
        return prepared.air, prepared.samples, prepared.ledger
    standard = standard_atmosphere(atmosphere or "")
    adjustment = unadjusted(standard, f"the standard atmosphere {standard.name}")
    timeless = TimedProfile(time_ns=None, profile=standard)
    air = FlightAir(adjustment, constant_series(timeless, exposures=0))
    return air, AirSamples(), Ledger()
