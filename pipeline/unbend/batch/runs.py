"""A mission is run into its folder: locked, hashed, resumed, published; rehearsed; looked at."""

import shutil
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.estimate.adjusted_profile import unadjusted
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.batch import opening, run_files, store
from unbend.batch.changes import drawn_before, reasons_to_run
from unbend.batch.executors import ALONE, Helpers, Outcome
from unbend.batch.file_hashes import check_unchanged
from unbend.batch.keys import code_of_stages, key_of_drawn, versions
from unbend.batch.object_store import Place
from unbend.batch.plan import (
    MANIFEST_VERSION,
    Plan,
    fetch_inputs,
    make_plan,
    outcome_of,
    places_named,
    refuse_other_mission,
)
from unbend.batch.publication import Publication, rehearse_place
from unbend.batch.run_files import write_tables
from unbend.batch.value_cache import keep, recall
from unbend.config.campaign import MissionRef
from unbend.errors import storage_errors
from unbend.messages import Ledger
from unbend.refraction.effect import FlightAir
from unbend.report.flown import Flown, flown_of
from unbend.report.html import write_report
from unbend.report.progress import Progress
from unbend.stages.correction import correct_counted
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.outputs import observation_metadata
from unbend.stages.statistics import SAMPLED_ROWS, Statistics
from unbend.stages.story import CorrectedMission, PreparedMission, correct_mission, prepare_mission


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
        batch_rows = plan.mission.output.batch_rows
        prepared = prepare(plan, progress)
        observations = prepared.observations
        progress.start("correcting", observations.rows)

        def correct_all(setup: CorrectionSetup) -> Statistics:
            check_unchanged(plan.inputs)
            folder.resume(f"{plan.keys['correction']} {batch_rows}", anew=force)
            return run_files.correct_into(
                run_files.PartsOfRun(folder, partial(check_unchanged, plan.inputs, folders=False)),
                observations,
                setup,
                batch_rows=batch_rows,
                metadata=observation_metadata(plan.mission),
                progress=progress.advance,
            )

        corrected = correct_mission(prepared, correct_all)
        progress.start("writing the report")
        write_tables(folder, corrected.stations, corrected.air)
        drawn = manifest_of(plan, corrected), drawing_of(corrected)
        manifest = finish_run(plan, folder, *drawn)
        keep(key_of_drawn(plan.keys["correction"], batch_rows), drawn)
    return outcome_of(plan, manifest, repeated=False)


def prepare(plan: Plan, progress: Progress, most_rows: int | None = None) -> PreparedMission:
    """Open the inputs of a mission, build its stations and estimate its air.

    ``most_rows`` of the observations are drawn, to stand for all.
    """
    ledger = Ledger()
    mission = plan.mission
    paths = {item.role: item.path for item in plan.inputs}
    if any(item.place for item in plan.inputs):
        progress.start("copying inputs from object storage")
    fetch_inputs(plan)
    progress.start("reading the observations")
    observations = opening.open_table(mission, paths["observations"], ledger, most_rows)
    progress.start("reading the log")
    hashes = {item.role: item.sha256 for item in plan.inputs}
    log = opening.decode_log(mission, paths, hashes.get("log"))
    inputs = opening.open_inputs(
        mission, paths, observations, log, ledger, camera_names=plan.camera_names
    )
    return prepare_mission(mission, inputs, ledger)


def manifest_of(plan: Plan, corrected: CorrectedMission) -> dict[str, Any]:
    """The manifest of a run, without its outputs.

    Holds no clock, no host name and no absolute path: the same inputs give the same bytes.
    """
    manifest = dict(corrected.manifest)
    for entry in manifest["ledger"]:  # a file is named as in the mission file, without its folder
        for item in plan.inputs:
            entry["where"] = str(entry["where"]).replace(str(item.path), item.name)
    return manifest | {
        "manifest_version": MANIFEST_VERSION,
        "mission": plan.mission.mission.name,
        "fingerprint": plan.fingerprint,
        "keys": plan.keys,
        "code": code_of_stages(),
        "config": plan.mission.model_dump(mode="json"),
        "inputs": [
            {"role": item.role, "name": item.name, "sha256": item.sha256} for item in plan.inputs
        ],
        "versions": versions(plan.libraries),
    }


@dataclass(frozen=True, eq=False)
class CheckedMission:
    """A rehearsed mission, and the manifest that it would have."""

    plan: Plan
    corrected: CorrectedMission
    manifest: dict[str, Any]


def check_mission(
    mission: MissionRef | Path | str, *, progress: Progress | None = None
) -> CheckedMission:
    """Rehearse a mission: all that `run_mission` does, on `SAMPLED_ROWS` rows; writes nothing."""
    progress, ref = progress or Progress(), MissionRef.of(mission)
    plan = make_plan(ref.load(), ref.folder)
    if isinstance(plan.output, Path):
        store.rehearse_folder(plan.output)
    finished_before(plan)
    if isinstance(plan.output, Place):
        rehearse_place(plan.output)
    prepared = prepare(plan, progress, SAMPLED_ROWS)
    progress.start("correcting a sample")

    def correct_sample(setup: CorrectionSetup) -> Statistics:
        _, _, statistics = correct_counted(prepared.observations.sampled(), setup)
        return statistics

    corrected = correct_mission(prepared, correct_sample)
    check_unchanged(plan.inputs)
    return CheckedMission(plan, corrected, manifest_of(plan, corrected))


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
    return prepare(make_plan(ref.load(), ref.folder), Progress())


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
