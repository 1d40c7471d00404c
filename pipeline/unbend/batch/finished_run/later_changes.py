"""What has changed in the mission file of a finished run, and in its inputs, since the run."""

import os
from pathlib import Path

from unbend.batch.differences import changed_inputs, changed_keys
from unbend.batch.finished_run import messages
from unbend.batch.finished_run.read_back import mission_of
from unbend.batch.runs import plan_of
from unbend.batch.unchanged import NOT_A_MISSION_FILE, name_and_output, text_of
from unbend.config.campaign import MissionRef, open_configs
from unbend.errors import ConfigError, UnbendError
from unbend.messages import Notes
from unbend.tables.manifest.whole import Manifest

_MOST_LISTED = 5  # changes in a message


def notes_on_changes(folder: Path, manifest: Manifest) -> Notes:
    """A warning (EXPORT-STALE) that the results in ``folder`` are older than the mission file.

    There is none if nothing has changed. Nothing is compared if the mission file is not where it
    was, seen from the results, or writes other results now, or if an input is not there: results
    are often kept without them.
    """
    # Without a name in the manifest this is the folder.
    file = Path(os.path.normpath(folder / manifest.run.mission_file))
    if not file.is_file():
        return ()
    try:
        changes = _changes(file, folder, manifest)
    except ConfigError as refusal:
        changes = [f"the mission file is refused now ({refusal.code})"]
    # An input is missing, a storage is silent, or the manifest is of another version.
    except UnbendError:
        return ()
    if not changes:
        return ()
    listed_changes = changes[:_MOST_LISTED]
    if len(changes) > _MOST_LISTED:
        listed_changes.append(f"and {len(changes) - _MOST_LISTED} more")
    return (messages.changed_since_run(file=str(file), changes=listed_changes),)


def _changes(file: Path, folder: Path, manifest: Manifest) -> list[str]:
    """The changes since the run as texts, keys before inputs.

    Empty too if the file has no mission of that name any more, or one with results elsewhere.
    Refuses what `plan_of` refuses. Inputs that seem changed are read and hashed.
    """
    run = manifest.run
    ref = _ref_of(file, run.mission)
    if ref is None:
        return []
    plan = plan_of(ref)
    if plan.fingerprint == run.fingerprint:
        return []
    is_same_mission = plan.mission.mission.name == run.mission
    if not is_same_mission or os.path.realpath(str(plan.output)) != os.path.realpath(folder):
        return []
    # As this version understands the mission of the run: keys that are new have their defaults.
    config_of_run = mission_of(manifest, folder).model_dump(mode="json")
    changes = [
        *changed_keys(plan.config, config_of_run),
        *changed_inputs(plan, run.inputs),
    ]
    # A stated null differs from an absent key, but has the same value.
    if not changes and plan.versions == run.versions:
        changes.append("a key is stated as null now, or is no longer")
    return changes


def _ref_of(file: Path, mission: str) -> MissionRef | None:
    """The mission of a mission file, of any name; or the one called ``mission`` of a campaign file.

    None if the campaign has no such mission.
    """
    refs, campaigns = open_configs([file])
    if not campaigns:
        return refs[0]
    for ref in refs:
        try:
            name, _ = name_and_output(ref, text_of(ref))
        except NOT_A_MISSION_FILE:  # another mission of the campaign
            continue
        if name == mission:
            return ref
    return None
