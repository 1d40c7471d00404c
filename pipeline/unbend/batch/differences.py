"""Why a mission would run: what differs from the run that made the present results."""

from collections.abc import Iterator, Mapping
from typing import Any

from unbend.batch.fingerprint import NOT_IN_FINGERPRINT
from unbend.batch.plan import Plan
from unbend.batch.results import find_damage
from unbend.tables.manifest.run import InputRecord
from unbend.tables.manifest.whole import Manifest


def reasons_to_run(plan: Plan, manifest: Manifest) -> list[str]:
    """Why a plan has to run although an earlier run has left a manifest; one sentence a reason.

    Empty if it need not run. If the manifest has the fingerprint of the plan, only damage of the
    results is a reason.
    """
    run = manifest.run
    if run.fingerprint == plan.fingerprint:
        return find_damage(plan.output, manifest, hash_all=False)
    reasons = [
        *changed_inputs(plan, run.inputs),
        *changed_keys(plan.config, run.config),
        *changed_versions(plan.versions, run.versions),
    ]
    if not reasons:
        # No value differs and yet the fingerprint does: the values are put together differently.
        reasons = ["the mission file is read in another way"]
    return reasons


def changed_inputs(plan: Plan, records: list[InputRecord]) -> Iterator[str]:
    """A sentence for each input that differs from those of a run; ``records`` are of that run."""
    hashes_before = {record.role: record.sha256 for record in records}
    inputs_now = {item.role: item for item in plan.inputs}
    for role in hashes_before:
        if role not in inputs_now:
            yield f"{role} is no longer read"
    for role, item in inputs_now.items():
        if role not in hashes_before:
            yield f"{role} is new ({item.name})"
        elif hashes_before[role] != item.sha256:
            yield f"{role} changed ({item.name})"


def changed_keys(config: Mapping[str, Any], config_of_run: Mapping[str, Any]) -> Iterator[str]:
    """A text for each key of the mission file that differs from that of a run, with both values."""
    values_before = dict(values_by_key(config_of_run))
    values_now = dict(values_by_key(config))
    for key in sorted(values_before.keys() | values_now.keys()):
        if key in NOT_IN_FINGERPRINT:
            continue
        value_before = values_before.get(key)
        value_now = values_now.get(key)
        if value_before != value_now:
            yield f"{key}: {_shown(value_before)} -> {_shown(value_now)}"


def changed_versions(
    versions: Mapping[str, str], versions_of_run: Mapping[str, str]
) -> Iterator[str]:
    """A text for each version that differs from that of a run, the program's first.

    Version and hash of the program's code give one text.
    """
    names = sorted(versions.keys() | versions_of_run.keys())
    changed = [name for name in names if versions.get(name) != versions_of_run.get(name)]
    of_program = ("unbend", "code_sha256")
    version_now = versions["unbend"]
    if "unbend" in changed:
        version_before = versions_of_run.get("unbend")
        yield f"another version of unbend ({version_before} -> {version_now})"
    elif "code_sha256" in changed:
        yield f"another source code of unbend {version_now}"
    for name in changed:
        if name not in of_program:
            text_before = _shown(versions_of_run.get(name))
            text_now = _shown(versions.get(name))
            yield f"{name} {text_before} -> {text_now}"


def values_by_key(values: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """The values in nested mappings and lists, each with its path of keys, as ``sections.0.key``.

    ``key`` is the path of ``values`` itself.
    """
    if isinstance(values, Mapping):
        items = list(values.items())
    elif isinstance(values, list):
        items = list(enumerate(values))
    else:
        yield key, values
        return
    for name, value in items:
        inner_key = f"{key}.{name}" if key else str(name)
        yield from values_by_key(value, inner_key)


def _shown(value: Any) -> str:
    """A value of a key, or a version, as text; "nothing" for None."""
    if value is None:
        return "nothing"
    return str(value)
