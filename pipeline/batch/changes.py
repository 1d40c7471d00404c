"""Why a mission would run: what differs from the run whose results are there."""

from collections.abc import Iterator, Mapping
from typing import Any

from pipeline.batch.plan import NOT_IN_KEY, Plan, versions


def changes_since(plan: Plan, manifest: Mapping[str, Any]) -> list[str]:
    """What differs between a plan and the run of a manifest, one sentence part each.

    Inputs by their role, keys of the mission file with both values, the program, its libraries.
    Empty where the fingerprints agree.
    """
    if manifest["fingerprint"] == plan.fingerprint:
        return []
    before = {item["role"]: item["sha256"] for item in manifest["inputs"]}
    now = {item.role: item for item in plan.inputs}
    changes = [f"{role} is no longer read" for role in before if role not in now]
    for role, item in now.items():
        if before.get(role) != item.sha256:
            changes.append(f"{role} {'changed' if role in before else 'is new'} ({item.name})")
    then, own = dict(_keys(manifest["config"])), dict(_keys(plan.mission.model_dump(mode="json")))
    for key in sorted(then.keys() | own.keys()):
        if key not in NOT_IN_KEY and then.get(key) != own.get(key):
            changes.append(f"{key}: {_shown(then.get(key))} -> {_shown(own.get(key))}")
    of_run, installed = manifest["versions"], versions()
    if of_run["code_sha256"] != installed["code_sha256"]:
        changes.append(f"another version of unbend ({of_run['unbend']} -> {installed['unbend']})")
    changes += [
        f"{name} {of_run.get(name)} -> {version}"
        for name, version in installed.items()
        if name not in ("unbend", "code_sha256", "python") and of_run.get(name) != version
    ]
    return changes


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
