"""What has changed in the mission file of a finished run, and in its inputs, since the run."""

import os
from pathlib import Path

import yaml

from unbend.batch.differences import changed_inputs, changed_keys
from unbend.batch.finished_run import messages
from unbend.batch.finished_run.read_back import mission_of
from unbend.batch.runs import plan_of
from unbend.batch.unchanged import name_and_output, text_of
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
    name_of_file = manifest.run.mission_file
    file = Path(os.path.normpath(folder / name_of_file))
    if not name_of_file or not file.is_file():
        return ()
    try:
        changes = _changes(file, folder, manifest)
    except ConfigError as refusal:
        changes = [f"the mission file is refused now ({refusal.code})"]
    except UnbendError:  # an input is missing, or a storage does not answer
        return ()
    if not changes:
        return ()
    listed_changes = changes[:_MOST_LISTED]
    if len(changes) > _MOST_LISTED:
        listed_changes.append(f"and {len(changes) - _MOST_LISTED} more")
    return (messages.changed_since_run(file=str(file), changes=listed_changes),)


def _changes(file: Path, folder: Path, manifest: Manifest) -> list[str]:
    """A text for each key and each input that differs now from those of the run."""
    run = manifest.run
    ref = _ref_of(file, run.mission)
    if ref is None:
        return []
    plan = plan_of(ref)
    is_same_mission = plan.mission.mission.name == run.mission
    if not is_same_mission or os.path.realpath(str(plan.output)) != os.path.realpath(folder):
        return []
    # As this version understands the mission of the run: keys that are new have their defaults.
    config_of_run = mission_of(manifest, folder).model_dump(mode="json")
    return [
        *changed_keys(plan.config, config_of_run),
        *changed_inputs(plan, run.inputs),
    ]


def _ref_of(file: Path, mission: str) -> MissionRef | None:
    """The mission of a mission file, or the one called ``mission`` of a campaign file.

    None if the campaign has no such mission. The name in a mission file is not looked at.
    """
    refs, campaigns = open_configs([file])
    if not campaigns:
        return refs[0]
    for ref in refs:
        try:
            name, _ = name_and_output(ref, text_of(ref))
        # The errors of a text that is not a mission file: another mission of the campaign.
        except (OSError, AttributeError, KeyError, TypeError, ValueError, yaml.YAMLError):
            continue
        if name == mission:
            return ref
    return None
