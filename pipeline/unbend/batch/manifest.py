"""The manifest of a run as a file: written, read, and compared with the results that it names."""

import json
import re
from collections.abc import Callable, Mapping

from unbend.batch import messages
from unbend.tables.manifest.messages import manifest_not_ours
from unbend.tables.manifest.whole import Manifest

_ATTEMPT = re.compile("[0-9a-f]{32}")


def manifest_text(manifest: Manifest) -> str:
    """The manifest as JSON; the same values give the same bytes."""
    values = manifest.values
    text = json.dumps(values, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    return text + "\n"


def parse_manifest(content: bytes, where: str, *, of_attempt: bool = False) -> Manifest:
    """The manifest from the content of its file; ``where`` is the path of the file, for messages.

    ``of_attempt`` : the manifest is in object storage, and must name the attempt with its files.
    Refuses (MANIFEST-UNREADABLE) a content that unbend did not write.
    """
    try:
        values = json.loads(content.decode("utf-8"))
    except ValueError as error:
        raise messages.manifest_unreadable(path=where, error=str(error)) from None
    if not isinstance(values, dict) or "outputs" not in values:
        raise manifest_not_ours(path=where)
    manifest = Manifest(values, where)
    run = manifest.run  # refuses a manifest without the values that all runs have
    if of_attempt and not _ATTEMPT.fullmatch(run.attempt):
        raise manifest_not_ours(path=where)
    return manifest


def damage_of(
    manifest: Manifest,
    sizes: Mapping[str, int],
    hash_of: Callable[[str], str | None],
) -> list[str]:
    """What is missing, changed or superfluous among the results of a manifest, one text each.

    ``sizes`` [bytes] are those of the existing files, by name. ``hash_of`` returns the SHA-256 of a
    file by its name, or None for a file that is trusted without reading it.
    """
    damage = []
    for item in manifest.run.outputs:
        if item.name not in sizes:
            damage.append(f"{item.name}: is missing")
        elif sizes[item.name] != item.bytes:
            damage.append(f"{item.name}: {sizes[item.name]} bytes, not {item.bytes}")
        elif hash_of(item.name) not in (None, item.sha256):
            damage.append(f"{item.name}: its content has changed")
    names = {item.name for item in manifest.run.outputs}
    superfluous = sorted(sizes.keys() - names)
    damage += [f"{name}: belongs to no run" for name in superfluous]
    return damage
