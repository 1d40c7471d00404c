"""Run a mission into a folder or a place in object storage; rehearse it; tell why it would run."""

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
from unbend.batch.plan import Plan, fetch_inputs, make_plan, refuse_other_mission, urls_in_refusals
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
    """Run one mission, unless an earlier run has made the same results.

    ``mission`` is a mission file, or what `load_mission` gives, which may have been changed since.
    ``force`` runs the mission in any case. With ``verify_inputs`` an input is read and hashed even
    if its size and time are those that it had in the earlier run.
    """
    progress = progress or Progress()
    progress.start("hashing the inputs")
    plan = plan_of(mission, verify=verify_inputs)
    with urls_in_refusals(plan):
        if isinstance(plan.output, Place):
            return run_and_publish(plan, place=plan.output, force=force, progress=progress)
        is_repeated, manifest = run_plan(plan, force=force, progress=progress)
        return outcome_of(plan, manifest, repeated=is_repeated)


def plan_of(mission: AnyMission, *, verify: bool = False) -> Plan:
    """The plan of a mission: the mission as understood, with its inputs hashed.

    ``verify`` reads and hashes each input, even if its size and time are unchanged.
    """
    if isinstance(mission, Mission):
        return make_plan(mission, folder_of(mission), verify=verify)
    ref = MissionRef.of(mission)
    loaded = load(ref)
    return make_plan(
        loaded.mission,
        ref.folder,
        verify=verify,
        text_sha256=loaded.text_sha256,
        file=Path(ref.campaign) if ref.campaign else ref.path,
    )


def run_and_publish(plan: Plan, *, place: Place, force: bool, progress: Progress) -> Outcome:
    """Run a mission in the user's cache, then publish its results at a place.

    * If the results of this plan are published already, nothing is done (``repeated``).
    * If an earlier command made them in the cache but could not publish them, they are published
      without a run.
    """
    # Made first, because a publication notes what is published now: if another run is published
    # from here on, this one is refused.
    publication = remote.Publication(place, plan.fingerprint)
    earlier = manifest_of_same_run(plan, force=force)
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
    """Run a mission that writes its results to a folder, unless they are there already.

    ``force`` runs it in any case. Returns True if an earlier run had made the results, so that
    nothing ran now, otherwise False; and the manifest of the results.
    """
    with store.open_folder(plan.folder) as folder:
        earlier = manifest_of_same_run(plan, force=force)
        if earlier is not None:
            return True, update_input_records(plan, folder, earlier)
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
        return False, finish_run(plan, folder, manifest, figure_data_of(corrected))


def prepare(plan: Plan, progress: Progress, most_rows: int | None = None) -> PreparedMission:
    """Open the inputs of a mission, build its stations and estimate its air.

    ``most_rows`` is the size of the sample that is drawn of the observations; None draws none.
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

    It contains no host name and no absolute path, and only the times of the inputs, so that equal
    runs give equal manifests.
    """
    ledger = [with_names_of_inputs(entry, plan.inputs) for entry in corrected.results.ledger]
    results = replace(corrected.results, ledger=ledger)
    return Manifest({**results.row(), **plan.identity().row()})


def with_names_of_inputs(entry: MessageRecord, inputs: Iterable[Input]) -> MessageRecord:
    """A message with the paths of inputs replaced by their names in the mission file."""
    where = entry.where
    for item in inputs:
        where = where.replace(str(item.path), item.name)
    return replace(entry, where=where)


def outcome_of(plan: Plan, manifest: Manifest, *, repeated: bool) -> Outcome:
    """The outcome of a mission, from the manifest of its results.

    ``repeated`` : an earlier run had made these results.
    """
    return Outcome(
        name=plan.mission.mission.name,
        output=plan.output,
        manifest=manifest,
        exit_code=manifest.run.exit_code,
        repeated=repeated,
    )


def manifest_of_same_run(plan: Plan, *, force: bool = False) -> Manifest | None:
    """The manifest of an earlier run with the results of this plan; None if the plan must run.

    With ``force`` the plan must run in any case. Refuses a damaged manifest, except with ``force``,
    and always (OUTPUT-OTHER) the manifest of another mission.
    """
    manifest = read_manifest(plan.output, ignore_damaged=force)
    refuse_other_mission(plan, manifest)
    if force or manifest is None or reasons_to_run(plan, manifest):
        return None
    return manifest


def update_input_records(plan: Plan, folder: store.RunFolder, manifest: Manifest) -> Manifest:
    """Write the present sizes and times of its inputs into the manifest of an unchanged run.

    If an input or the mission file was copied or written again with the same content, the next run
    then need not read it. Returns the new manifest, also if the folder cannot be written to.
    """
    now = plan.identity()
    before = manifest.run
    # The plan of a mission that was loaded earlier has no hash of the file: the old one stays.
    file_sha256 = now.mission_file_sha256 or before.mission_file_sha256
    file = now.mission_file or before.mission_file
    is_same_file = (before.mission_file, before.mission_file_sha256) == (file, file_sha256)
    if before.inputs == now.inputs and is_same_file:
        return manifest
    values_now = {
        "inputs": [asdict(record) for record in now.inputs],
        "mission_file": file,
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
    manifest_of_same_run(plan)  # only for its refusals: a rehearsal ignores earlier results
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
    """The plan of a mission, and why `run_mission` would run it now, one sentence a reason.

    There are no reasons if it would not run. Nothing is locked or written.
    """
    plan = plan_of(mission)
    manifest = read_manifest(plan.output, ignore_damaged=True)
    refuse_other_mission(plan, manifest)
    if manifest is None:
        return plan, [f"{plan.output} has no results of it"]
    return plan, reasons_to_run(plan, manifest)


def figure_data_of(corrected: CorrectedMission) -> Flown:
    """The data of the report's figures that are not in its manifest."""
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
    """Write the report, and last the manifest, which shows that the run is finished.

    Returns the manifest with the outputs.
    """
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
    """Read the inputs of a mission, build its stations and estimate its air."""
    return prepare(plan_of(mission), Progress())


def profile_in_light(
    config: Path | None,
    atmosphere: str | None,
    *,
    camera: str | None = None,
    wavelength_m: float | None = None,
) -> tuple[Profile, Ledger]:
    """The profile of a mission or a standard atmosphere, for one wavelength; and the notes on it.

    ``config`` is a mission file; None takes the standard atmosphere called ``atmosphere``. The
    wavelength in vacuum [m] is ``wavelength_m``, else that of the mission's ``camera``, else that
    of the mission or the standard. Refuses (ConfigError ANGLE-CAMERA) an unknown camera.
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
    """The air of a mission or a standard atmosphere, with the samples and the notes of the mission.

    ``config`` is a mission file; None takes the standard atmosphere called ``atmosphere``, which
    has no samples and no notes.
    """
    if config is not None:
        prepared = read_mission(config)
        return prepared.air, prepared.samples, prepared.ledger
    standard = standard_atmosphere(atmosphere or "")
    adjustment = unadjusted(standard, f"the standard atmosphere {standard.name}")
    timeless = TimedProfile(time_ns=None, profile=standard)
    air = FlightAir(adjustment, constant_series(timeless, exposures=0))
    return air, AirSamples(), Ledger()
