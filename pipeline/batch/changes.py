"""Why a mission would run: what differs from the run whose results are there."""

from collections.abc import Iterator, Mapping
from typing import Any

import pipeline
from pipeline.batch.plan import NOT_IN_KEY, Plan, code_hash, library_versions
from pipeline.batch.store import find_damage


def reasons_to_run(plan: Plan, manifest: Mapping[str, Any]) -> list[str]:
    """Why the results of a manifest are not those of a plan, whole and unchanged; else empty.

    Contents of the parts of observations are not read.
    """
    return changes_since(plan, manifest) or find_damage(plan.output, dict(manifest), read=False)


def changes_since(plan: Plan, manifest: Mapping[str, Any]) -> list[str]:
    """What differs between a plan and the run of a manifest, one sentence part each.

    Inputs by their role, keys of the mission file with both values, the program, its libraries.
    Empty where the fingerprints agree.
    """
    if manifest["fingerprint"] == plan.fingerprint:
        return []
    before = {item["role"]: item["sha256"] for item in manifest.get("inputs", ())}
    now = {item.role: item for item in plan.inputs}
    changes = [f"{role} is no longer read" for role in before if role not in now]
    for role, item in now.items():
        if before.get(role) != item.sha256:
            changes.append(f"{role} {'changed' if role in before else 'is new'} ({item.name})")
    then = dict(_keys(manifest.get("config", {})))
    own = dict(_keys(plan.mission.model_dump(mode="json")))
    for key in sorted(then.keys() | own.keys()):
        if key not in NOT_IN_KEY and then.get(key) != own.get(key):
            changes.append(f"{key}: {_shown(then.get(key))} -> {_shown(own.get(key))}")
    of_run = manifest.get("versions", {})
    if of_run.get("code_sha256") != code_hash():
        of_both = f"{of_run.get('unbend')} -> {pipeline.__version__}"
        changes.append(f"another version of unbend ({of_both})")
    changes += [
        f"{name} {of_run.get(name)} -> {version}"
        for name, version in library_versions().items()
        if of_run.get(name) != version
    ]
    return changes or ["the mission file is read in another way"]


def _keys(values: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """The values of nested mappings and lists by their keys, as ``sections.0.key``."""
    items: Any = ()
    if isinstance(values, Mapping):
        items = values.items()
    elif isinstance(values, list):
        items = enumerate(values)
    else:
        yield key, values
    for name, value in items:
        yield from _keys(value, f"{key}.{name}" if key else str(name))


def _shown(value: Any) -> str:
    return "nothing" if value is None else str(value)
