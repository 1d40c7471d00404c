"""Messages of blocks of other programs: cameras, orientations, image points and object points."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from unbend.errors import Code, Counted, InputError
from unbend.messages import Message, note, warning
from unbend.tables.imports.messages import (
    IMPORT_FORMAT,
    NAME_OR_EXPORT,
    ORIENTATION_EMPTY,
    ORIENTATION_FRAME,
    ORIENTATION_REPEATED,
)
from unbend.tables.messages import OBS_EMPTY

CAMERA_NAME = Code(
    "CAMERA-NAME",
    means=(
        "The calibration file contains several cameras and none is named, or it does not contain "
        "the named one."
    ),
    effect="The mission is refused.",
    remedy="Name it under cameras.<name>.camera.",
)


def camera_unnamed(*, where: Path | str, cameras: str) -> InputError:
    """A file has several cameras, and the mission file names none; ``cameras`` lists them."""
    return InputError(
        CAMERA_NAME,
        "it contains {cameras}, and no camera is named",
        where=where,
        remedy="name one of them under camera",
        cameras=cameras,
    )


def camera_not_there(*, where: Path | str, cameras: str, name: str) -> InputError:
    """The camera that the mission file names is not in the file."""
    return InputError(
        CAMERA_NAME,
        "it contains {cameras}, but no {name!r}",
        where=where,
        remedy="name one of them under camera",
        cameras=cameras,
        name=name,
    )


def _refused_import(
    where: Path | str, text: str, *, remedy: str = NAME_OR_EXPORT, **values: Any
) -> InputError:
    """The refusal (IMPORT-FORMAT) of a file that is damaged, incomplete or not supported."""
    return InputError(IMPORT_FORMAT, text, where=where, remedy=remedy, **values)


# Errors of libraries on a damaged file; ``program`` is the expected format.


def damaged(*, where: Path | str, program: str) -> InputError:
    """A file is damaged; the error of the library has no meaning for a user."""
    text = "as a file of {program}: something in it is not as that program writes it"
    return _refused_import(where, text, program=program)


def part_missing(*, where: Path | str, program: str, part: str) -> InputError:
    """An element or a name that the format has is not in the file."""
    return _refused_import(
        where, "as a file of {program}: it has no {part}", program=program, part=part
    )


def not_json(*, where: Path | str, program: str, line: int) -> InputError:
    """A line of a file is not valid JSON."""
    text = "as a file of {program}: line {line} is not valid JSON"
    return _refused_import(where, text, program=program, line=line)


def not_xml(*, where: Path | str, program: str, line: int) -> InputError:
    """A line of a file is not valid XML."""
    text = "as a file of {program}: line {line} is not valid XML"
    return _refused_import(where, text, program=program, line=line)


def not_database(*, where: Path | str, program: str, error: str) -> InputError:
    """SQLite cannot read a file, or it lacks the program's tables."""
    text = "as a file of {program}: it is not such a database, or it is damaged ({error})"
    return _refused_import(where, text, program=program, error=error)


def not_readable(*, where: Path | str, program: str, error: str) -> InputError:
    """The operating system reports an error on reading a file."""
    text = "as a file of {program}: it cannot be read: {error}"
    return _refused_import(where, text, program=program, error=error)


# Any block


def line_unreadable(*, where: Path | str, line: int) -> InputError:
    """A line of a text has a wrong number of fields, or text where a number belongs."""
    return _refused_import(where, "line {line} is not as that program writes it", line=line)


def bytes_behind(*, where: Path | str, count: int) -> InputError:
    """A binary file has ``count`` bytes after its last record."""
    return InputError(
        IMPORT_FORMAT,
        "{count} extra bytes at the end: it is damaged, or of another version",
        one="1 extra byte at the end: it is damaged, or of another version",
        where=where,
        count=count,
        remedy=NAME_OR_EXPORT,
    )


def record_cut(*, where: Path | str, size: int, offset: int, needed: int) -> InputError:
    """A binary file of ``size`` bytes ends within the record of ``needed`` bytes at ``offset``."""
    text = "the file was cut off: it has {size}, and the record from byte {offset} on {needed}"
    return _refused_import(where, text, size=Counted(size, "byte"), offset=offset, needed=needed)


def no_orientation(*, where: Path | str) -> InputError:
    """No image of a block is oriented."""
    return InputError(
        ORIENTATION_EMPTY,
        "no image is oriented",
        where=where,
        remedy="write it again, with one orientation for each image",
    )


def image_repeated(*, where: Path | str, image: str) -> InputError:
    """An image occurs twice in a block."""
    return InputError(
        ORIENTATION_REPEATED,
        "{image!r} occurs twice",
        where=where,
        remedy="write it again, with one orientation for each image",
        image=image,
    )


def no_rotation(*, where: Path | str, image: str) -> InputError:
    """The quaternion of an image is not of length 1, or its matrix is not a rotation."""
    return _refused_import(where, "the orientation of {image!r} is not a rotation", image=image)


def position_beyond(*, where: Path | str, item: str, largest: float) -> InputError:
    """A position is infinite, or farther away than any on earth in any unit."""
    text = "the position of {item!r} has a coordinate of {largest:g}"
    return _refused_import(where, text, item=item, largest=largest)


# COLMAP


def not_a_model(*, where: Path | str) -> InputError:
    """Orientations or points are needed, but the path is a database or a single file."""
    return _refused_import(
        where,
        "it is not a model: a database or a file has neither orientations nor object points",
        remedy=(
            "name the folder of a model, as sparse/0; with a database, name it as "
            "stations.orientation.path"
        ),
    )


def colmap_model_unknown(*, where: Path | str, number: int, last: int) -> InputError:
    """The number of a camera model is unknown, as of a later version of COLMAP."""
    text = "its camera model number {number} is not known: COLMAP 4.2 has 0 to {last}"
    return _refused_import(where, text, number=number, last=last)


def database_in_use(*, where: Path | str, log: str) -> InputError:
    """A database has rows that are only in its write-ahead log, which is not read."""
    return _refused_import(
        where,
        "{log} next to it has rows that are not yet in the database",
        remedy="close the program that uses the database, or open and close the database",
        log=log,
    )


def keypoints_cut(
    *, where: Path | str, image: str, size: int, rows: int, columns: int
) -> InputError:
    """The keypoints of an image have ``size`` bytes, which does not fit their rows and columns."""
    text = "the keypoints of {image!r} are {size}, not {rows} of {columns} float32"
    return _refused_import(
        where,
        text,
        image=image,
        size=Counted(size, "byte"),
        rows=Counted(rows, "row"),
        columns=columns,
    )


def matches_cut(*, where: Path | str, table: str, one: str, other: str) -> InputError:
    """The matches of two images are not as many bytes as their rows need."""
    return _refused_import(
        where,
        "the {table} of {one_image!r} and {other_image!r} are cut off",
        remedy="match the images again",
        table=table,
        one_image=one,
        other_image=other,
    )


def camera_of_image_unknown(*, where: Path | str, line: int, image: str, camera: str) -> InputError:
    """An image of a model has a camera that is not in the model's file of cameras."""
    text = "in line {line}, {image!r} has camera {camera}, which is not in cameras.txt"
    return _refused_import(where, text, line=line, image=image, camera=camera)


COLMAP_COUNT = Code(
    "COLMAP-COUNT",
    means=(
        "A text file of COLMAP has another number of records than its comment states, or its last "
        "line has no end. But the references between the records are complete."
    ),
    effect="The records in the file are used.",
    remedy="If records are missing, write the model again.",
)


def count_of_comment(*, where: Path | str, found: int, stated: int) -> Message:
    """The comment of a text states another number of records than the text has (``found``)."""
    return warning(
        COLMAP_COUNT,
        "it has {found}, but its comment states {stated}: the records in the file are used",
        where=str(where),
        found=Counted(found, "record"),
        stated=stated,
    )


def line_without_end(*, where: Path | str) -> Message:
    """The last line of a text has no newline."""
    return warning(
        COLMAP_COUNT,
        "its last line has no end: if the file was cut there, its last number is wrong",
        where=str(where),
    )


def records_missing(*, where: Path | str, found: int, total: int) -> InputError:
    """A text of COLMAP is cut off: ``found`` of ``total`` records were read."""
    text = "the file was cut off after {found} of {total}"
    return _refused_import(where, text, found=found, total=Counted(total, "record"))


def keypoints_none(*, where: Path | str, pairs: int) -> InputError:
    """A database of COLMAP has no keypoints; ``pairs`` of images have matches."""
    return InputError(
        OBS_EMPTY,
        "the database has no keypoints, but matches of {pairs}",
        where=where,
        remedy="extract features first, or name another file",
        pairs=Counted(pairs, "pair"),
    )


# Metashape


def is_folder(*, where: Path | str) -> InputError:
    """The path of a Metashape file is a folder."""
    remedy = "name a .psz or .psx, or an exported .xml"
    return _refused_import(where, "it is a folder", remedy=remedy)


def metashape_version(*, where: Path | str, tag: str, version: str) -> InputError:
    """A document has a version of Metashape that is not supported."""
    text = "it is a {tag} of version {version}; versions 1 and 2 of Metashape are supported"
    return _refused_import(where, text, tag=tag, version=version)


def no_chunk(*, where: Path | str) -> InputError:
    """A document has no chunk."""
    return _refused_import(where, "it has no chunk", remedy="export the chunk with the cameras")


def several_chunks(*, where: Path | str, chunks: int, names: str) -> InputError:
    """A document has several chunks."""
    return _refused_import(
        where,
        "it has {chunks} ({names}); only one can be read",
        remedy="keep only the needed chunk, or export only this chunk",
        chunks=Counted(chunks, "chunk"),
        names=names,
    )


def several_frames(*, where: Path | str, frames: int) -> InputError:
    """A chunk has several frames (moments of time)."""
    text = "the chunk has {frames} frames; only one can be read"
    return _refused_import(where, text, frames=frames)


def archive_part_missing(*, where: Path | str, part: str) -> InputError:
    """The document of an archive names a file that the archive does not have."""
    return _refused_import(where, "it does not contain {part}, which its document names", part=part)


def ply_cut(*, where: Path | str, part: str, size: int, records: int, each: int) -> InputError:
    """The points of an archive have ``size`` bytes, not ``records`` records of ``each`` bytes."""
    text = "{part} was cut off, or has another format: {size} for {records} of {each}"
    return _refused_import(
        where,
        text,
        part=part,
        size=Counted(size, "byte"),
        records=Counted(records, "record"),
        each=each,
    )


def calibration_missing(*, where: Path | str) -> InputError:
    """A camera of Metashape has no adjusted calibration."""
    return _refused_import(where, "the camera has no adjusted calibration")


def calibration_unusable(*, where: Path | str, coefficients: str, kind: str) -> InputError:
    """A calibration has coefficients that no camera of this package has."""
    return _refused_import(
        where,
        "{coefficients} of a {kind} calibration cannot be used",
        remedy="adjust the camera without these coefficients, and export it again",
        coefficients=coefficients,
        kind=kind,
    )


# OpenSfM


def tracks_version(*, where: Path | str, first_line: str, expected: str) -> InputError:
    """The tracks of OpenSfM are of another version."""
    return _refused_import(
        where,
        "its first line is {first_line!r}, not {expected}",
        remedy="write it again with OpenSfM 0.5 or newer",
        first_line=first_line,
        expected=expected,
    )


def several_reconstructions(*, where: Path | str, found: int) -> InputError:
    """A file has no reconstruction, or several."""
    return _refused_import(
        where,
        "{found}, each with separate cameras",
        remedy="keep one of them",
        found=Counted(found, "reconstruction"),
    )


def vector_missing(*, where: Path | str, item: str, key: str) -> InputError:
    """A shot or a point lacks a vector, or its vector has not three numbers."""
    return _refused_import(where, "{item!r} has no {key} of three numbers", item=item, key=key)


def reconstruction_in_utm(*, where: Path | str, evidence: str, name: str) -> InputError:
    """ODM's reconstruction is in UTM minus an offset, and the earlier one (``name``) is missing.

    ``evidence`` is the file that shows it.
    """
    return InputError(
        ORIENTATION_FRAME,
        (
            "{evidence} of ODM shows that it is in UTM minus an offset, not in east, north, up at "
            "reference_lla: it is turned by the convergence of the grid"
        ),
        where=where,
        evidence=evidence,
        remedy="copy ODM's {name} into the same folder; it is then read instead",
        name=name,
    )


BLOCK_ODM = Code(
    "BLOCK-ODM",
    means="The reconstruction is the one that ODM kept before it overwrote the other one with UTM.",
    effect="The stations are in east, north, up at reference_lla.",
    remedy="Nothing.",
)


def reconstruction_before_odm(*, where: Path | str) -> Message:
    """The earlier reconstruction is read, not the one that ODM has overwritten in UTM."""
    return note(
        BLOCK_ODM,
        (
            "{name} is read: in a project of ODM it is in east, north, up at reference_lla, while "
            "reconstruction.json is in UTM minus an offset"
        ),
        where=str(where),
        name=Path(where).name,
    )


BLOCK_DISABLED = Code(
    "BLOCK-DISABLED",
    means="Cameras of the project are disabled. They were not part of its adjustment.",
    effect="These images and their image points are left out, because their poses may be old.",
    remedy="If they are needed, enable and align them in the project.",
)


def disabled_cameras(*, where: Path | str, names: Sequence[str]) -> Message:
    """Disabled cameras are left out; ``names`` are those of their images."""
    return note(
        BLOCK_DISABLED,
        "{disabled} left out, the first is {first}",
        where=str(where),
        disabled=Counted(len(names), "disabled camera is", "disabled cameras are"),
        first=names[0],
    )


# Pix4D


def several_of_pix4d(*, where: Path | str, name: str, files: int) -> InputError:
    """A folder has ``files`` files with the same ending of name, so of several projects."""
    return _refused_import(
        where,
        "it has {files} that end in {name}",
        remedy="name the needed file of the project",
        files=Counted(files, "file"),
        name=name,
    )


def offset_missing(*, where: Path | str, name: str) -> InputError:
    """The projection centres are relative to an offset, and no file states the offset."""
    return _refused_import(
        where,
        "its projection centres are relative to the project's offset, which is not in any file",
        remedy="copy the project's ..._{name} or its external parameters into the same folder",
        name=name,
    )


def files_of_pix4d_differ(
    *, where: Path | str, image: str, away_m: float, turned_deg: float
) -> InputError:
    """An image has different poses in the two files of a project."""
    return _refused_import(
        where,
        "{image!r} is {away_m:.3g} m away and turned by {turned_deg:.3g} deg in the file of "
        "external parameters",
        remedy="give both files and the offset of the same calibration",
        image=image,
        away_m=away_m,
        turned_deg=turned_deg,
    )


# BlocksExchange


def is_folder_of_xml(*, where: Path | str) -> InputError:
    """The path of a BlocksExchange file is a folder."""
    return _refused_import(where, "it is a folder", remedy="name the exported .xml")


def not_blocks_exchange(*, where: Path | str, tag: str) -> InputError:
    """An XML file is not a BlocksExchange; ``tag`` is its root."""
    return _refused_import(where, "it is a {tag}, not a BlocksExchange", tag=tag)


def several_blocks(*, where: Path | str, blocks: int, names: str) -> InputError:
    """A file has no block, or several."""
    return _refused_import(
        where,
        "it has {blocks} ({names}); only one can be read",
        remedy="export only the needed block",
        blocks=Counted(blocks, "block"),
        names=names,
    )


def system_of_group(*, where: Path | str, name: str) -> InputError:
    """A photogroup is in another spatial reference system than its block."""
    return _refused_import(
        where,
        "the photogroup {name!r} is in another spatial reference system than its block",
        remedy="export the block in one spatial reference system",
        name=name,
    )


def rotation_unreadable(*, where: Path | str, angles: str) -> InputError:
    """A rotation is neither a matrix nor omega, phi, kappa; ``angles`` lists its elements."""
    return _refused_import(
        where,
        "its rotations are {angles}, and the format does not state the formula of these angles",
        remedy="export them as matrices, or as omega, phi, kappa",
        angles=angles,
    )


def photo_unknown(*, where: Path | str, point: str, number: str) -> InputError:
    """A point is measured in a photo that the block does not have."""
    text = "{point!r} is measured in photo {number}, which does not exist"
    return _refused_import(where, text, point=point, number=number)


# DBAT


def dbat_version(*, where: Path | str, version: str) -> InputError:
    """A script or a camera has a version of DBAT that is not supported."""
    text = "it is a script of DBAT version {version}; only version 1.0 is supported"
    return _refused_import(where, text, version=version)


def dbat_cameras(*, where: Path | str, cameras: int) -> InputError:
    """A script has no or several cameras: its report does not state the camera of each image."""
    return _refused_import(
        where,
        "it has {cameras}; only one can be read",
        remedy="give stations.orientation",
        cameras=Counted(cameras, "camera"),
    )


def dbat_without_report(*, where: Path | str) -> InputError:
    """A script does not name the report of an adjustment."""
    return _refused_import(
        where,
        "the script names no report, which has the orientations",
        remedy=(
            "add the element output/files/report/file to the script and run DBAT again, or give "
            "stations.orientation"
        ),
    )


def orientation_cut(*, where: Path | str, image: str) -> InputError:
    """The report lacks values of an image's orientation."""
    return _refused_import(where, "the orientation of {image} is incomplete", image=image)


def image_number_unknown(*, where: Path | str, place: str, number: str) -> InputError:
    """An image point has the number of an image that the script does not have."""
    return _refused_import(
        where, "{place}: no image has the number {number}", place=place, number=number
    )


def camera_not_plain(*, where: Path | str, name: str, plain: float) -> InputError:
    """The skew or the aspect of a camera is not ``plain``, the only value that is supported."""
    return _refused_import(
        where, "the {name} of its camera is not {plain:g}", name=name, plain=plain
    )


def dbat_model_unknown(*, where: Path | str, model: float) -> InputError:
    """The number of a lens distortion model is not known."""
    text = (
        "the lens distortion model {model:g} of its camera is unknown; known models are 1, 2 and 3"
    )
    return _refused_import(where, text, model=model)


INPUT_MISSING = Code(
    "INPUT-MISSING",
    means="A file that the mission file names, or a file of its block, does not exist.",
    effect="The mission is refused.",
    remedy="Check the path; paths are relative to the mission file.",
)


def file_of_model_missing(*, where: Path | str, name: str) -> InputError:
    """The folder of a COLMAP model lacks one of its three files."""
    return InputError(
        INPUT_MISSING,
        "a model of COLMAP has a {name}",
        where=where,
        remedy="name its folder, as sparse/0",
        name=name,
    )


def file_of_project_missing(*, where: Path | str, name: str) -> InputError:
    """The folder of an OpenSfM project lacks a file that is needed."""
    return InputError(
        INPUT_MISSING,
        "a project of OpenSfM has a {name}",
        where=where,
        remedy="name the folder of the project; for ODM, the folder opensfm",
        name=name,
    )


def file_of_pix4d_missing(*, where: Path | str, name: str) -> InputError:
    """The parameters of a Pix4D project lack a file that is needed."""
    return InputError(
        INPUT_MISSING,
        "no file there ends in {name}",
        where=where,
        remedy=(
            "name the folder params of the project, or its ..._calibrated_camera_parameters.txt; "
            "if there is no ..._tp_pix4d.txt, give the image points as a table under observations"
        ),
        name=name,
    )


def folder_of_project_missing(*, where: Path | str, name: str) -> InputError:
    """The folder of a Metashape project, or an archive in it, does not exist."""
    return InputError(
        INPUT_MISSING,
        "the project names {name}, which does not exist",
        where=where,
        remedy=(
            "copy the project's .psx file and its .files folder together, or save it in Metashape "
            "as .psz, or export cameras and markers as .xml"
        ),
        name=name,
    )


def file_of_script_missing(*, where: Path | str, name: str) -> InputError:
    """A file that a DBAT script names exists neither at its path nor next to the script."""
    return InputError(
        INPUT_MISSING,
        "the script names {name}",
        where=where,
        remedy="put the file at the path in the script, or next to the script",
        name=name,
    )
