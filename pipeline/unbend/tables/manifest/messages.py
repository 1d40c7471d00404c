"""The refusal of a manifest that is not one of a run."""

from unbend.errors import Code, StorageError

MANIFEST_UNREADABLE = Code(
    "MANIFEST-UNREADABLE",
    means="The manifest of the results cannot be read, or was not written by unbend.",
    effect="The command is refused.",
    remedy="Run the mission again with --force, or choose another folder.",
)


def manifest_not_ours(*, path: str) -> StorageError:
    """The manifest is JSON, but lacks values that every manifest of unbend has."""
    return StorageError(
        MANIFEST_UNREADABLE,
        "manifest.json was not written by unbend",
        where=path,
        remedy="choose another folder, or remove that file and the results next to it",
    )
