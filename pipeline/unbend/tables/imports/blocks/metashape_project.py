"""The documents of Metashape: archives (.psz), projects (.psx), and exported files (.xml).

An archive contains ``doc.xml`` and the tables that it names. A project is a small file next to a
folder of the same name with the ending ``.files``. In the folder ``project.zip`` names the
``chunk.zip`` of each chunk, which names the ``frame.zip`` of each frame, which names the archive of
its tie points. Each of these has a ``doc.xml`` with paths relative to its folder. All are returned
as one document, as an archive has it.
"""

import zipfile
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from unbend.tables.imports.blocks import messages

_TYPES_OF_PLY = {
    "float": "<f4",
    "double": "<f8",
    "int": "<i4",
    "uint": "<u4",
    "uchar": "u1",
    "short": "<i2",
    "ushort": "<u2",
    "char": "i1",
}
_PATH_SEPARATOR = "|"  # joins the path of a project's archive and the name of a file in it


def files_of_project(path: Path) -> tuple[Path, ...]:
    """The file itself, and the archives of a project (.psx).

    Refuses a folder, and a project with an archive that does not exist.
    """
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
    """The XML document of a file, or of a project with all its parts; refuses versions after 2."""
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
    """The only chunk of a document; refuses a document with none or several."""
    chunks = [*document(path).iter("chunk")]
    if not chunks:
        raise messages.no_chunk(where=path)
    if len(chunks) > 1:
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
    """The vertices of a binary PLY as a structured array with the properties of the PLY.

    ``name`` is a file in the archive ``path``, or in a project an archive and the file in it,
    joined by `_PATH_SEPARATOR`.
    """
    archive_path = path
    if _PATH_SEPARATOR in name:
        archive_name, name = name.split(_PATH_SEPARATOR)
        archive_path = Path(archive_name)
    with zipfile.ZipFile(archive_path) as archive:
        if name not in archive.namelist():
            raise messages.archive_part_missing(
                where=archive_path,
                part=name,
            )
        head, _, content = archive.read(name).partition(b"end_header\n")
    count = 0
    properties = []
    for line in head.decode("ascii").splitlines():
        words = line.split()
        if words[:2] == ["element", "vertex"]:
            count = int(words[2])
        elif words[:1] == ["property"]:
            _, type_name, property_name = words[:3]
            properties.append((property_name, _TYPES_OF_PLY[type_name]))
    vertex_type = np.dtype(properties)
    if b"binary_little_endian" not in head or len(content) != count * vertex_type.itemsize:
        raise messages.ply_cut(
            where=archive_path,
            part=name,
            size=len(content),
            records=count,
            each=vertex_type.itemsize,
        )
    return np.frombuffer(content, vertex_type)


def _document_in(archive_path: Path) -> ElementTree.Element:
    """The document ``doc.xml`` of an archive."""
    with zipfile.ZipFile(archive_path) as archive:
        return ElementTree.fromstring(archive.read("doc.xml"))


def _archive_of_project(path: Path) -> Path:
    """The archive ``project.zip`` that a project (.psx) names; refuses a project without it."""
    root = ElementTree.fromstring(path.read_bytes())
    archive_name = root.get("path", "{projectname}.files/project.zip")
    archive = path.parent / archive_name.replace("{projectname}", path.stem)
    if not archive.is_file():
        raise messages.folder_of_project_missing(
            where=path,
            name=archive.parent.name,
        )
    return archive


def _parts(
    archive_path: Path,
    xpath: str,
) -> Iterator[tuple[ElementTree.Element, Path]]:
    """As `_named_parts`, of the document in an archive."""
    yield from _named_parts(_document_in(archive_path), archive_path, xpath)


def _named_parts(
    root: ElementTree.Element,
    archive_path: Path,
    xpath: str,
) -> Iterator[tuple[ElementTree.Element, Path]]:
    """The elements of a document that name another archive, each with the path of that archive.

    ``root`` is the document of the archive ``archive_path``; ``xpath`` finds the elements. Refuses
    an archive that does not exist.
    """
    for element in root.iterfind(xpath):
        part_name = element.get("path")
        if part_name is None:
            continue
        part = archive_path.parent / part_name
        if not part.is_file():
            raise messages.folder_of_project_missing(
                where=archive_path,
                name=part_name,
            )
        yield element, part


def _document_of_project(project: Path) -> ElementTree.Element:
    """The document of a project, with its chunks, frames and tie points in place of their paths.

    ``project`` is its archive ``project.zip``.
    """
    root = _document_in(project)
    for chunk_place, chunk_path in _named_parts(root, project, "chunks/chunk"):
        chunk = _document_in(chunk_path)
        for frame_place, frame_path in _named_parts(chunk, chunk_path, "frames/frame"):
            frame = _document_in(frame_path)
            for cloud_place, cloud_path in _named_parts(frame, frame_path, "point_cloud"):
                cloud = _document_in(cloud_path)
                for element in cloud.iter():
                    if "path" in element.attrib:
                        element.set(
                            "path", f"{cloud_path}{_PATH_SEPARATOR}{element.attrib['path']}"
                        )
                _put(cloud, cloud_place)
            _put(frame, frame_place)
        _put(chunk, chunk_place)
    return root


def _put(
    content: ElementTree.Element,
    place: ElementTree.Element,
) -> None:
    """Add attributes and children of a part's document to ``place``, the element that named it."""
    place.attrib.update(content.attrib)
    place.extend(content)
