"""DJI's tags in the XMP of an image, whichever way a camera or a tag editor has written them.

A JPEG has its XMP in a separate segment before the pixels; other files have it somewhere as plain
text. XMP is XML: a property is an attribute, or an element, with the
name space of DJI. A document type, which could declare entities, is refused.
"""

import mmap
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO
from xml.etree import ElementTree

NAMESPACE = (
    "{http://www.dji.com/drone-dji"  # begins a property's name in ElementTree; its version follows
)
_HEAD_OF_XMP = b"http://ns.adobe.com/xap/1.0/\0"  # of an APP1 segment; others hold EXIF
MOST_BYTES = 1 << 20  # of a packet of XMP; a segment of a JPEG has 64 KiB at most
SEARCHED_BYTES = 1 << 25  # of a file that is not a JPEG

_JPEG = b"\xff\xd8"
_SEGMENT_APP1 = 0xE1
_MARKERS_WITHOUT_LENGTH = {0x01, *range(0xD0, 0xD9)}
_LAST_MARKERS = {0xD9, 0xDA}  # the end of the image, and the beginning of its pixels


def dji_tags(path: Path) -> dict[str, str]:
    """DJI's tags of an image by their names; empty without XMP.

    Raises ValueError for XMP that is not XML, is larger than a megabyte, has a document type, or
    states two values of one tag.
    """
    with path.open("rb") as file:
        is_jpeg = file.read(2) == _JPEG
        packets = list(xmp_of_jpeg(file)) if is_jpeg else [xmp_in_text(file)]
    tags: dict[str, str] = {}
    for packet in packets:
        if not packet:
            continue
        new_tags = properties_of_dji(packet)
        for name in tags.keys() & new_tags.keys():
            if tags[name] != new_tags[name]:
                raise ValueError(f"its XMP states {name} twice: {tags[name]} and {new_tags[name]}")
        tags |= new_tags
    return tags


def xmp_of_jpeg(file: BinaryIO) -> Iterator[bytes]:
    """Each packet of XMP of a JPEG; ``file`` is positioned after the first marker, `_JPEG`.

    There may be two packets: some editors keep the camera's and write another before it.
    """
    for marker, length in _segments(file):
        if marker != _SEGMENT_APP1:
            continue
        begin = file.tell()
        if file.read(len(_HEAD_OF_XMP)) == _HEAD_OF_XMP:
            yield file.read(length - len(_HEAD_OF_XMP))
        file.seek(begin)


def _segments(file: BinaryIO) -> Iterator[tuple[int, int]]:
    """The marker of each segment before the pixels, and the length of its content in bytes.

    At each yield ``file`` is positioned at the first byte of the content. Ends without an error at
    a damaged length or at the end of the file.
    """
    while True:
        mark = file.read(1)
        while mark == b"\xff":  # the prefix of a marker, and fill bytes
            mark = file.read(1)
        if not mark or mark[0] in _LAST_MARKERS:
            return
        if mark[0] in _MARKERS_WITHOUT_LENGTH:
            continue
        length = int.from_bytes(file.read(2), "big") - 2  # it counts its own two bytes
        if length < 0:
            return
        begin = file.tell()
        yield mark[0], length
        file.seek(begin + length)


def xmp_in_text(file: BinaryIO) -> bytes:
    """The XMP in a file that is not a JPEG; empty if its first 32 MiB (`SEARCHED_BYTES`) have none.

    Raises ValueError for XMP without an end within a megabyte.
    """
    if file.seek(0, 2) == 0:
        return b""
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        begin = content.find(b"<x:xmpmeta", 0, SEARCHED_BYTES)
        if begin < 0:
            return b""
        end = content.find(b"</x:xmpmeta>", begin, begin + MOST_BYTES)
        if end < 0:
            raise ValueError(f"its XMP has no end within {MOST_BYTES} bytes")
        return bytes(content[begin : end + len(b"</x:xmpmeta>")])


def properties_of_dji(packet: bytes) -> dict[str, str]:
    """The properties of a packet of XMP that have DJI's name space, by name without name space.

    Raises ValueError for a packet that is not XML, is larger than a megabyte, or has a document
    type.

    >>> properties_of_dji(b'''<a xmlns:d="http://www.dji.com/drone-dji/1.0/" d:Roll="+1.0">
    ... <d:Yaw>-2.5</d:Yaw>
    ... </a>''')
    {'Roll': '+1.0', 'Yaw': '-2.5'}
    """
    if len(packet) > MOST_BYTES:
        raise ValueError(f"its XMP has more than {MOST_BYTES} bytes")
    text = packet.decode("utf-8-sig")
    if "<!DOCTYPE" in text.upper():
        raise ValueError("its XMP has a document type, which XMP never has")
    try:
        root = ElementTree.fromstring(text[text.find("<") : text.rfind(">") + 1])
    except ElementTree.ParseError as error:
        raise ValueError(f"its XMP is not XML: {error}") from None
    properties: dict[str, str] = {}
    for element in root.iter():
        # A property is an attribute, or an element with a text.
        names_and_values = [*element.attrib.items(), (element.tag, element.text or "")]
        for name, value in names_and_values:
            if name.startswith(NAMESPACE):
                properties[name.partition("}")[2]] = value.strip()
    return properties
