"""Why a mission would run: what differs from the run whose results are there."""

from collections.abc import Iterator, Mapping
from typing import Any

import pipeline
from pipeline.batch.kept import is_kept
from pipeline.batch.keys import (
    NOT_IN_KEY,
    STAGES,
    code_of_stages,
    key_of_drawn,
    stage_of_key,
    stage_of_role,
)
from pipeline.batch.plan import Plan
from pipeline.batch.store import find_damage


def reasons_to_run(plan: Plan, manifest: Mapping[str, Any]) -> list[str]:
    """Why the results of a manifest are not those of a plan, whole and unchanged; else empty.

    Contents of the parts of observations are not read.
    """
    return changes_since(plan, manifest) or find_damage(plan.output, dict(manifest), read=False)


def changes_since(plan: Plan, manifest: Mapping[str, Any]) -> list[str]:
    """What differs between a plan and the run of a manifest, one sentence part each.

    Each by the stage that begins again for it, these in their order: inputs by their role, keys of
    the mission file with both values, the program, its libraries. Empty where fingerprints agree.
    The last one says where the log is still known as it was decoded, or the corrections stay.
    """
    if manifest["fingerprint"] == plan.fingerprint:
        return []
    changes = [*changed_inputs(plan, manifest), *changed_keys(plan, manifest)]
    of_run, codes = manifest.get("versions", {}), manifest.get("code", {})
    for stage, code in code_of_stages().items():
        if codes.get(stage) != code:
            text = f"another version of unbend ({of_run.get('unbend')} -> {pipeline.__version__})"
            changes.append((stage, text))
            break  # the later ones begin again all the same
    changes += [
        (stage, f"{name} {_shown(of_run.get(name))} -> {_shown(version)}")
        for stage, of_stage in plan.libraries.items()
        for name, version in of_stage.items()
        if of_run.get(name) != version
    ]
    if not changes:
        return ["the mission file is read in another way"]
    changes.sort(key=lambda change: STAGES.index(change[0]))
    texts = [f"{stage}: {text}" for stage, text in changes]
    before, now = manifest.get("keys", {}), plan.keys
    if before.get("correction") == now["correction"] and is_kept(drawn_before(manifest)):
        texts[-1] += "; nothing is corrected again"
    elif before.get("ingest") == now["ingest"] and plan.mission.log is not None:
        texts[-1] += "; the log is not read again" if is_kept(plan.decoded_log) else ""
    return texts


def drawn_before(manifest: Mapping[str, Any]) -> str:
    """What the figures of a finished run's report are kept under."""
    batch_rows = manifest["config"]["output"]["batch_rows"]
    return key_of_drawn(manifest["keys"]["correction"], batch_rows)


def changed_inputs(plan: Plan, manifest: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The inputs that differ from those of a run, each behind its stage."""
    before = {item["role"]: item["sha256"] for item in manifest.get("inputs", ())}
    now = {item.role: item for item in plan.inputs}
    for role in before.keys() - now.keys():
        yield stage_of_role(role), f"{role} is no longer read"
    for role, item in now.items():
        if before.get(role) != item.sha256:
            how = "changed" if role in before else "is new"
            yield stage_of_role(role), f"{role} {how} ({item.name})"


def changed_keys(plan: Plan, manifest: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The keys of the mission file that differ, with both values, each behind its stage."""
    then = dict(_keys(manifest.get("config", {})))
    own = dict(_keys(plan.mission.model_dump(mode="json")))
    for key in sorted(then.keys() | own.keys()):
        if key not in NOT_IN_KEY and then.get(key) != own.get(key):
            yield stage_of_key(key), f"{key}: {_shown(then.get(key))} -> {_shown(own.get(key))}"


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
