"""Results where they are: in a folder, or published in object storage."""

from pathlib import Path

from unbend.batch import messages, remote, store
from unbend.batch.remote import Place
from unbend.config.other_files import results_folder_of
from unbend.tables.manifest.whole import Manifest


def read_manifest(output: Path | Place, *, ignore_damaged: bool = False) -> Manifest | None:
    """The manifest of a run's results; None without a manifest.

    A damaged manifest is refused; with ``ignore_damaged`` None is returned for it.
    """
    if isinstance(output, Place):
        return remote.read_manifest(output, ignore_damaged=ignore_damaged)
    return store.read_manifest(output, ignore_damaged=ignore_damaged)


def find_damage(output: Path | Place, manifest: Manifest, *, hash_all: bool = True) -> list[str]:
    """What is missing or changed among the results of a run, one text each.

    ``hash_all`` reads and hashes all files. Without it only those are read that changed after the
    manifest was written; in object storage none is read.
    """
    if isinstance(output, Place):
        return remote.find_damage(output, manifest, hash_all=hash_all)
    return store.find_damage(output, manifest, hash_all=hash_all)


def manifest_of_run(output: Path | Place) -> Manifest:
    """The manifest of a finished run; refuses (VERIFY-NO-MANIFEST) an output without one."""
    manifest = read_manifest(output)
    if manifest is not None:
        return manifest
    path = str(output)
    if not isinstance(output, Path):
        raise messages.no_manifest(path=path)
    if output.is_file():
        folder = results_folder_of(output)
        folder_text = "" if folder is None else str(folder)
        raise messages.file_instead_of_run(
            path=path,
            folder=folder_text,
        )
    if output.is_dir() and not store.has_traces(output):
        raise messages.no_folder_of_results(path=path)
    raise messages.no_manifest(path=path)


def verify_run(output: Path | Place) -> Manifest:
    """The manifest of a run, after a check that its results are complete and unchanged.

    Refuses missing or changed results (VERIFY-DAMAGED), and an output without a manifest.
    """
    manifest = manifest_of_run(output)
    damage = find_damage(output, manifest)
    if not damage:
        return manifest
    if isinstance(output, Place):
        published_now = read_manifest(output)
        if published_now != manifest:
            return verify_run(output)  # another run was published while this one was read
    raise messages.results_damaged(path=str(output), damage=damage)
