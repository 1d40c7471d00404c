"""Why a mission would run: what differs from the run whose results are there."""

from collections.abc import Iterator, Mapping
from typing import Any

from unbend.batch.fingerprint import NOT_IN_FINGERPRINT
from unbend.batch.plan import Plan
from unbend.batch.results import find_damage
from unbend.tables.manifest.run import InputRecord
from unbend.tables.manifest.whole import Manifest


def reasons_to_run(plan: Plan, manifest: Manifest) -> list[str]:
    """Why a plan has to run although a manifest is there, one reason each; empty if it need not.

    Where the manifest is that of the same plan, only damage of its results is a reason.
    """
    run = manifest.run
    if run.fingerprint == plan.fingerprint:
        return find_damage(plan.output, manifest, read=False)
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
    """The inputs that differ from those of a run."""
    hashes_before = {record.role: record.sha256 for record in records}
    inputs_now = {item.role: item for item in plan.inputs}
    for role in hashes_before.keys() - inputs_now.keys():
        yield f"{role} is no longer read"
    for role, item in inputs_now.items():
        if role not in hashes_before:
            yield f"{role} is new ({item.name})"
        elif hashes_before[role] != item.sha256:
            yield f"{role} changed ({item.name})"


def changed_keys(config: Mapping[str, Any], of_run: Mapping[str, Any]) -> Iterator[str]:
    """The keys of the mission file that differ from those of a run, with both values."""
    before = dict(values_by_key(of_run))
    now = dict(values_by_key(config))
    for key in sorted(before.keys() | now.keys()):
        if key in NOT_IN_FINGERPRINT:
            continue
        value_before = before.get(key)
        value_now = now.get(key)
        if value_before != value_now:
            yield f"{key}: {_shown(value_before)} -> {_shown(value_now)}"


def changed_versions(versions: Mapping[str, str], of_run: Mapping[str, str]) -> Iterator[str]:
    """The versions that differ from those of a run, that of the program first.

    Version and hash of the program's code are one difference.
    """
    names = sorted(versions.keys() | of_run.keys())
    changed = [name for name in names if versions.get(name) != of_run.get(name)]
    of_program = ("unbend", "code_sha256")
    if any(name in changed for name in of_program):
        yield f"another version of unbend ({of_run.get('unbend')} -> {versions['unbend']})"
    for name in changed:
        if name not in of_program:
            version_before = _shown(of_run.get(name))
            version_now = _shown(versions.get(name))
            yield f"{name} {version_before} -> {version_now}"


def values_by_key(values: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """The values of nested mappings and lists by their keys, as ``sections.0.key``."""
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
    """A value of a key or a version, in words where there is none."""
    if value is None:
        return "nothing"
    return str(value)
