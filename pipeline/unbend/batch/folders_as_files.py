"""The refusal of a folder in the place of an input file, with the file that may be meant."""

from pathlib import Path

from unbend.batch import messages
from unbend.batch.input_files import NamedInput
from unbend.config.other_files import results_folder_of
from unbend.errors import InputError

TABLES = (".csv", ".txt", ".tsv", ".parquet", ".pq")
"""Endings of tables of observations."""


def folder_refusal(named: NamedInput, path: Path) -> InputError:
    """The refusal (INPUT-FOLDER) of the folder at ``path``, which an input names as its file."""
    run = results_folder_of(path)
    if run is not None:
        return messages.results_as_input(
            role=named.role,
            path=str(path),
            key=named.key,
            run=str(run),
        )
    file_name = only_fitting_file(path, named.role)
    suggested_path = ""
    if file_name:
        name_of_folder = named.name.rstrip("/")
        suggested_path = f"{name_of_folder}/{file_name}"
    return messages.folder_as_input(
        role=named.role,
        path=str(path),
        key=named.key,
        meant=suggested_path,
    )


def only_fitting_file(folder: Path, role: str) -> str:
    """The name of the only file in a folder with an ending that fits a role.

    "" if there is none or more than one. Hidden files are left out.
    """
    endings = fitting_endings(role)
    fitting = []
    try:
        for file in folder.iterdir():
            has_ending = not endings or file.suffix.lower() in endings
            if has_ending and not file.name.startswith(".") and file.is_file():
                fitting.append(file.name)
            if len(fitting) > 1:
                return ""
    except OSError:
        return ""
    return fitting[0] if fitting else ""


def fitting_endings(role: str) -> tuple[str, ...]:
    """The endings of files for a role of inputs; empty if any ending fits."""
    if role == "observations":
        return TABLES
    if role != "log":
        return ()
    # Imported here: it takes long, and is needed only for a refusal.
    from unbend.ingest.registry import FORMATS

    endings: list[str] = []
    for log_format in FORMATS:
        endings.extend(log_format.extensions)
    return tuple(endings)
