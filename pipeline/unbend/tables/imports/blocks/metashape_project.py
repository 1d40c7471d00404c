"""The documents of Metashape: archives (.psz), projects (.psx), and what was exported (.xml).

An archive holds ``doc.xml`` and the tables that it names. A project is a small file beside a folder
of the same name with the ending ``.files``: there ``project.zip`` names ``chunk.zip`` of each
chunk, that ``frame.zip`` of each frame, that the archive of its tie points, each with a ``doc.xml``
and paths that count from its own folder. All come as one document, as an archive has it.
"""

import zipfile
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from unbend.tables.imports.blocks import messages

_TYPES = {
    "float": "<f4",
    "double": "<f8",
    "int": "<i4",
    "uint": "<u4",
    "uchar": "u1",
    "short": "<i2",
    "ushort": "<u2",
    "char": "i1",
}
_OTHER_FILE = "|"  # between an archive and the name of a file in it, in paths of a project


def files_of_project(path: Path) -> tuple[Path, ...]:
    """The file itself; of a project its archives too. Refuses a folder, and archives that lack."""
    if path.is_dir():
        raise messages.is_folder(where=path)
    if path.suffix.lower() != ".psx":
        return (path,)
    files = [path]
    project = _archive_of_project(path)
    files.append(project)
    for _, chunk in _parts(project, "chunks/chunk"):
        files.append(chunk)
        for _, frame in _parts(chunk, "frames/frame"):
            files.append(frame)
            files += [cloud for _, cloud in _parts(frame, "point_cloud")]
    return tuple(files)


def document(path: Path) -> ElementTree.Element:
    """The document of a file, all of a project's parts in one; refuses a version after 2."""
    if path.suffix.lower() == ".psx":
        root = _document_of_project(_archive_of_project(path))
    elif zipfile.is_zipfile(path):
        root = _document_in(path)
    else:
        root = ElementTree.fromstring(path.read_bytes())
    version = root.get("version", "1" if root.tag == "calibration" else "")
    if version.partition(".")[0] not in ("1", "2"):
        raise messages.metashape_version(
            where=path,
            tag=root.tag,
            version=version or "unknown",
        )
    return root


def only_chunk(path: Path) -> ElementTree.Element:
    """The chunk of a document; refuses none, and several."""
    chunks = [*document(path).iter("chunk")]
    if len(chunks) != 1:
        names = ", ".join(repr(chunk.get("label", "")) for chunk in chunks)
        raise messages.several_chunks(
            where=path,
            chunks=len(chunks),
            names=names,
        )
    return chunks[0]


def vertices(
    path: Path,
    name: str,
) -> NDArray[np.void]:
    """The vertices of a binary PLY in an archive, a structured array."""
    archive_path = path
    if _OTHER_FILE in name:
        other, name = name.split(_OTHER_FILE)
        archive_path = Path(other)
    with zipfile.ZipFile(archive_path) as archive:
        if name not in archive.namelist():
            raise messages.archive_part_missing(
                where=archive_path,
                part=name,
            )
        head, _, content = archive.read(name).partition(b"end_header\n")
    count = 0
    kinds = []
    for words in (line.split() for line in head.decode("ascii").splitlines()):
        if words[:2] == ["element", "vertex"]:
            count = int(words[2])
        elif words[:1] == ["property"]:
            kinds.append((words[2], _TYPES[words[1]]))
    kind = np.dtype(kinds)
    if b"binary_little_endian" not in head or len(content) != count * kind.itemsize:
        raise messages.ply_cut(
            where=archive_path,
            part=name,
            size=len(content),
            records=count,
            each=kind.itemsize,
        )
    return np.frombuffer(content, kind)


def _document_in(archive_path: Path) -> ElementTree.Element:
    with zipfile.ZipFile(archive_path) as archive:
        return ElementTree.fromstring(archive.read("doc.xml"))


def _archive_of_project(path: Path) -> Path:
    """The archive that a project names; refuses where the folder is not beside it."""
    root = ElementTree.fromstring(path.read_bytes())
    named = root.get("path", "{projectname}.files/project.zip")
    archive = path.parent / named.replace("{projectname}", path.stem)
    if not archive.is_file():
        raise messages.folder_of_project_missing(
            where=path,
            name=archive.parent.name,
        )
    return archive


def _parts(
    archive_path: Path,
    where: str,
) -> Iterator[tuple[ElementTree.Element, Path]]:
    """The elements of an archive's document that stand for another archive, and its path."""
    yield from _named_parts(_document_in(archive_path), archive_path, where)


def _named_parts(
    root: ElementTree.Element,
    archive_path: Path,
    where: str,
) -> Iterator[tuple[ElementTree.Element, Path]]:
    for element in root.iterfind(where):
        named = element.get("path")
        if named is None:
            continue
        part = archive_path.parent / named
        if not part.is_file():
            raise messages.folder_of_project_missing(
                where=archive_path,
                name=named,
            )
        yield element, part


def _document_of_project(project: Path) -> ElementTree.Element:
    """The document of a project, with chunks, frames and tie points in the place of their paths."""
    root = _document_in(project)
    for chunk_place, chunk_path in _named_parts(root, project, "chunks/chunk"):
        chunk = _document_in(chunk_path)
        for frame_place, frame_path in _named_parts(chunk, chunk_path, "frames/frame"):
            frame = _document_in(frame_path)
            for cloud_place, cloud_path in _named_parts(frame, frame_path, "point_cloud"):
                cloud = _document_in(cloud_path)
                for element in cloud.iter():
                    if "path" in element.attrib:
                        element.set("path", f"{cloud_path}{_OTHER_FILE}{element.attrib['path']}")
                _put(cloud, cloud_place)
            _put(frame, frame_place)
        _put(chunk, chunk_place)
    return root


def _put(
    content: ElementTree.Element,
    place: ElementTree.Element,
) -> None:
    """Put the content of a part's document in the place that named it."""
    place.attrib.update(content.attrib)
    place.extend(content)
