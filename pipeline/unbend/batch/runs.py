"""A mission is run into its folder: locked, hashed, resumed, published; rehearsed; looked at."""

import shutil
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.estimate.adjusted_profile import unadjusted
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.batch import opening, remote, store
from unbend.batch.differences import reasons_to_run
from unbend.batch.executors import Outcome
from unbend.batch.input_files import Input
from unbend.batch.plan import Plan, fetch_inputs, make_plan, places_named, refuse_other_mission
from unbend.batch.remote import Place
from unbend.batch.results import read_manifest
from unbend.batch.run_files import PartsOfRun, correct_into, write_tables
from unbend.batch.unchanged import load
from unbend.config.campaign import MissionRef
from unbend.errors import StorageError, storage_errors
from unbend.messages import Ledger, MessageRecord
from unbend.refraction.effect import FlightAir
from unbend.report.flown import Flown, flown_of
from unbend.report.html import write_report
from unbend.report.progress import Progress
from unbend.stages.correction import correct_counted
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.results import observation_metadata
from unbend.stages.statistics import SAMPLED_ROWS, Statistics
from unbend.stages.story import CorrectedMission, PreparedMission, correct_mission, prepare_mission
from unbend.tables.manifest.whole import Manifest


def run_mission(
    mission: MissionRef | Path | str,
    *,
    force: bool = False,
    verify_inputs: bool = False,
    progress: Progress | None = None,
) -> Outcome:
    """Run one mission, unless the results that are there are those that it would give.

    ``force`` runs it in any case. ``verify_inputs`` reads also inputs that are unchanged by size
    and time.
    """
    progress = progress or Progress()
    progress.start("hashing the inputs")
    plan = plan_of(mission, verify=verify_inputs)
    with places_named(plan):
        if isinstance(plan.output, Place):
            return run_and_publish(plan, place=plan.output, force=force, progress=progress)
        is_repeated, manifest = run_plan(plan, force=force, progress=progress)
        return outcome_of(plan, manifest, repeated=is_repeated)


def plan_of(mission: MissionRef | Path | str, *, verify: bool = False) -> Plan:
    """A mission file as understood, with its inputs hashed."""
    ref = MissionRef.of(mission)
    loaded = load(ref)
    return make_plan(loaded.mission, ref.folder, verify=verify, text_sha256=loaded.text_sha256)


def run_and_publish(plan: Plan, *, place: Place, force: bool, progress: Progress) -> Outcome:
    """Run a mission in the user's cache, then publish its results at a place.

    Results that an earlier command made there and could not publish are published without a run.
    """
    publication = remote.Publication(place, plan.fingerprint)
    earlier = finished_before(plan, force=force)
    if earlier is not None:
        return outcome_of(plan, earlier, repeated=True)
    remote.rehearse(place, writes=True)
    with storage_errors(plan.folder):
        plan.folder.mkdir(parents=True, exist_ok=True)
    lock = store.lock_folder(plan.folder.parent)
    try:
        here = replace(plan, output=plan.folder)
        is_repeated, made = run_plan(here, force=force, progress=progress)
        if is_repeated and store.find_damage(plan.folder, made):
            # What is uploaded has to be whole, by the content of each file.
            _, made = run_plan(here, force=True, progress=progress)
        size = sum(output.bytes for output in made.run.outputs)
        progress.start("uploading", size)
        manifest = publication.publish(plan.folder, made, progress.advance)
        shutil.rmtree(plan.folder, ignore_errors=True)
    finally:
        lock.release()
    return outcome_of(plan, manifest, repeated=False)


def run_plan(plan: Plan, *, force: bool, progress: Progress) -> tuple[bool, Manifest]:
    """Run a mission with its inputs hashed, whose results go to a folder.

    Returns whether an earlier run had made these results, so that nothing ran, and their manifest.
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

    ``most_rows`` of the observations are drawn, to stand for all.
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
    """The manifest of an earlier run that made what this plan would make; None where it must run.

    With ``force`` it must run in any case, and a damaged manifest is not refused. The manifest of
    another mission is always refused.
    """
    manifest = read_manifest(plan.output, damaged=force)
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
    if before.inputs == now.inputs and before.mission_file_sha256 == now.mission_file_sha256:
        return manifest
    inputs = [asdict(record) for record in now.inputs]
    seen = {"inputs": inputs, "mission_file_sha256": now.mission_file_sha256}
    as_now = manifest.with_values(seen)
    with suppress(StorageError):
        folder.rewrite_manifest(as_now)
    return as_now


@dataclass(frozen=True, eq=False)
class CheckedMission:
    """A rehearsed mission, and the manifest that it would have."""

    plan: Plan
    corrected: CorrectedMission
    manifest: Manifest


def check_mission(
    mission: MissionRef | Path | str, *, progress: Progress | None = None
) -> CheckedMission:
    """Rehearse a mission: all that `run_mission` does, on `SAMPLED_ROWS` rows; writes nothing."""
    progress = progress or Progress()
    plan = plan_of(mission)
    if isinstance(plan.output, Path):
        store.rehearse_folder(plan.output)
    finished_before(plan)
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


def mission_status(mission: MissionRef | Path | str) -> tuple[Plan, list[str]]:
    """Why `run_mission` would run a mission now, one reason each; nothing is locked or written."""
    plan = plan_of(mission)
    manifest = read_manifest(plan.output, damaged=True)
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
    report = folder.place("report.html")
    with storage_errors(report):
        write_report(report, manifest, flown)
    folder.seal("report.html")
    plan.check_unchanged()
    outputs = [asdict(output) for output in folder.outputs()]
    manifest = manifest.with_values({"outputs": outputs})
    folder.commit(manifest)
    return manifest


def read_mission(mission: MissionRef | Path) -> PreparedMission:
    """A mission with everything read, its stations built and its air estimated."""
    return prepare(plan_of(mission), Progress())


def air_of_mission_or_standard(
    config: Path | None, atmosphere: str | None
) -> tuple[FlightAir, AirSamples, Ledger]:
    """The air of a mission with its samples and notes, or a standard atmosphere by its name."""
    if config is not None:
        prepared = read_mission(config)
        return prepared.air, prepared.samples, prepared.ledger
    standard = standard_atmosphere(atmosphere or "")
    adjustment = unadjusted(standard, f"the standard atmosphere {standard.name}")
    air = FlightAir(adjustment, constant_series(TimedProfile(None, standard), 0))
    return air, AirSamples(), Ledger()
