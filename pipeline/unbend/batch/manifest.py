"""The manifest of a run as it is written: read back, and compared with what it names."""

import json
import re
from collections.abc import Callable, Mapping
from typing import Any

from unbend.batch import messages

MANIFEST = "manifest.json"
"""Written last: it exists only when all that it names does."""

_REQUIRED = {"fingerprint", "mission", "outputs", "exit_code"}
"""Keys that manifests of all versions have."""

_ATTEMPT = re.compile("[0-9a-f]{32}")


def manifest_text(manifest: Mapping[str, Any]) -> str:
    """The manifest as JSON; the same values give the same bytes."""
    text = json.dumps(manifest, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    return text + "\n"


def parse_manifest(content: bytes, where: str, *, of_attempt: bool = False) -> dict[str, Any]:
    """The manifest in a file; refuses (MANIFEST-UNREADABLE) what unbend did not write.

    One in object storage names an attempt.
    """
    try:
        manifest = json.loads(content.decode("utf-8"))
    except ValueError as error:
        raise messages.manifest_unreadable(path=where, error=str(error)) from None
    if not isinstance(manifest, dict) or not manifest.keys() >= _REQUIRED:
        raise messages.manifest_not_ours(path=where)
    outputs = manifest["outputs"]
    if not isinstance(outputs, list) or not all(isinstance(item, dict) for item in outputs):
        raise messages.manifest_not_ours(path=where)
    if of_attempt and not _ATTEMPT.fullmatch(str(manifest.get("attempt"))):
        raise messages.manifest_not_ours(path=where)
    return manifest


def damage_of(
    manifest: Mapping[str, Any],
    sizes: Mapping[str, int],
    hash_of: Callable[[str], str | None],
) -> list[str]:
    """What is missing, changed or too many among results, one line each.

    ``sizes`` by the names of the files that are there; ``hash_of`` a file, None to trust it.
    """
    damage = []
    for item in manifest["outputs"]:
        name = str(item["name"])
        if name not in sizes:
            damage.append(f"{name}: is missing")
        elif sizes[name] != item["bytes"]:
            damage.append(f"{name}: {sizes[name]} bytes, not {item['bytes']}")
        elif hash_of(name) not in (None, item["sha256"]):
            damage.append(f"{name}: its content has changed")
    known = {str(item["name"]) for item in manifest["outputs"]}
    damage += [f"{name}: belongs to no run" for name in sorted(sizes.keys() - known)]
    return damage
