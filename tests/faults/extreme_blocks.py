"""Blocks of other programs and the tags of images with fields at their limits."""

import struct
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pyproj

from tests.dbat_project import write_project
from tests.faults.extreme_inputs import (
    Reader,
    extreme_fields,
    extreme_number,
    of_texts,
    with_ledger,
)
from tests.faults.extreme_tables import DAY, GPST, TOW, UNIX_S, WEEK, table
from tests.small_block import SmallBlock
from unbend.errors import UnbendError
from unbend.tables.imports import blocks
from unbend.tables.imports.exif import read_gimbal_orientations, read_image_times

BLOCK_PROGRAMS = {
    "colmap": ".",
    "opensfm": ".",
    "metashape": "doc.xml",
    "pix4d": ".",
    "blocksexchange": "block.xml",
    "dbat": "sxb.xml",
}
"""Programs, and the path in a folder that is given to the reader."""


def read_block(path, program):
    """All that a block is read for."""
    reader = blocks.block_reader(program)
    with blocks.damage_refused(path, program):
        makers = reader.read_cameras(path)
        for maker in makers.values():
            maker()
    points = blocks.read_block_points(path, program)[1]
    images = blocks.read_block_images(path, program)
    places = [known.position for known in blocks.read_block_places(path, program)]
    for _ in blocks.block_rows(path, program):
        pass
    return points, images.position, images.angles, places


@cache
def small_blocks():
    """By kind: the path in the folder that is given to the reader, and the files of a block."""
    block = SmallBlock.make()
    block.names, block.lat, block.lon, block.h = (
        block.names[:3],
        *(values[:3] for values in (block.lat, block.lon, block.h)),
    )
    block.cam_from_enu = block.cam_from_enu[:3]
    block.observations = block.observed().groupby("image").head(4)
    kinds = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        places = np.column_stack([block.lat, block.lon, block.h])
        for kind in BLOCK_PROGRAMS:
            (folder / kind).mkdir()
        block.write_colmap(folder / "colmap")
        block.write_opensfm(folder / "opensfm")
        block.write_metashape(
            folder / "metashape" / "doc.xml",
            reference=pyproj.CRS.from_epsg(4326).to_wkt("WKT1_GDAL"),
            known=places[:, [1, 0, 2]],
        )
        block.write_pix4d(folder / "pix4d", 32632, offset=np.array([465000.0, 5238000.0, 0.0]))
        block.write_blocks_exchange(
            folder / "blocksexchange" / "block.xml", "EPSG:32632", known=places
        )
        write_project(folder / "dbat")
        for mark in ("markpts.txt", "smartpts.txt"):
            path = folder / "dbat" / mark
            path.write_text("\n".join(path.read_text().splitlines()[:40]) + "\n")
        for kind, start in BLOCK_PROGRAMS.items():
            files = {}
            for path in sorted((folder / kind).iterdir()):
                files[path.name] = path.read_text("utf-8")
            kinds[kind] = (start, files)
    return kinds


def first_row(lines):
    """The index of the first line that is neither empty nor a remark."""
    return next(k for k, line in enumerate(lines) if line and not line.startswith("#"))


def block_reader(program) -> Reader:
    """A block of a program, which is written when it is drawn the first time."""

    def write(folder, draw):
        of_texts(small_blocks()[program][1], read).write(folder, draw)

    def read(folder):
        start = small_blocks()[program][0]
        return read_block(folder / start, program)

    return Reader(write, read)


def write_colmap_binary(folder, draw):
    """A model of one camera, two images and two points; one of its numbers is at its limits."""
    parts = {
        "cameras.bin": [
            ("Q", [1]),
            ("iiQQ", [1, 1, 4000, 3000]),
            ("4d", [3000.0, 3000.0, 2000.0, 1500.0]),
        ],
        "images.bin": [("Q", [2])],
        "points3D.bin": [("Q", [2])],
    }
    for image in (1, 2):
        parts["images.bin"] += [
            ("i7di", [image, 0.8, 0.6, 0.0, 0.0, 1.0, 2.0, 3.0, 1]),
            ("6s", [b"a%d.jp\0" % image]),
            ("Q", [2]),
            ("2dq", [100.5, 200.5, 1]),
            ("2dq", [300.5, 400.5, -1]),
        ]
        parts["points3D.bin"] += [
            ("Q3d3BdQ", [image, 1.0, 2.0, 3.0, 1, 2, 3, 0.5, 1]),
            ("ii", [1, 0]),
        ]
    spoilt = draw.choice(list(parts))
    record = draw.randrange(len(parts[spoilt]))
    for name, records in parts.items():
        content = b""
        for number, (form, values) in enumerate(records):
            letters = expanded(form)
            numbers = list(values)
            if name == spoilt and number == record and "s" not in form:
                place = draw.randrange(len(numbers))
                kind = np.dtype(letters[place].replace("q", "i8").replace("Q", "u8"))
                numbers[place] = extreme_number(kind, draw).item()
            content += struct.pack("<" + form, *numbers)
        (folder / name).write_bytes(content)


def expanded(form):
    """The letters of a form of struct without counts: 3dB as dddB.

    >>> expanded("i2dQ")
    'iddQ'
    """
    letters = ""
    count = 1
    for letter in form:
        if letter.isdigit():
            count = int(letter)
        else:
            letters += letter * count
            count = 1
    return letters


BLOCKS = {f"block of {program}": block_reader(program) for program in BLOCK_PROGRAMS}
BLOCKS["block of colmap, binary"] = Reader(
    write_colmap_binary, lambda folder: read_block(folder, "colmap")
)

# Tags of images

TAG_ROWS = {
    "tags with dates": table(
        "SourceFile,DateTimeOriginal,SubSecTimeOriginal,OffsetTimeOriginal,GPSDateStamp,"
        "GPSTimeStamp,GPSLatitude,GPSLongitude,GPSAltitude,GPSAltitudeRef,FocalLength,"
        "GimbalRollDegree,GimbalPitchDegree,GimbalYawDegree",
        lambda k: (
            f"a/IMG_{k}.JPG,2026:05:06 12:00:0{k},{k}5,+02:00,2026:05:06,10:00:0{k},"
            f"47 deg 18' {k}.50\" N,8 deg 30' 0.50\" E,{1500 + k}.5 m,0,100.0 mm,0.1,-90.0,+{k}2.5"
        ),
    ),
    "tags with weeks": table(
        "image,gps_week,gps_seconds,GPSLatitude,GPSLatitudeRef,GPSLongitude,GPSLongitudeRef,"
        "AbsoluteAltitude,RelativeAltitude,GimbalRollDegree,GimbalPitchDegree,GimbalYawDegree",
        lambda k: (
            f"IMG_{k}.JPG,{WEEK},{TOW + k}.500000,47.3{k},N,8.5{k},E,+{1500 + k}.5,+100.5,0.0,-90.0"
            f",+{k}2.5"
        ),
    ),
    "tags with Unix times": table(
        "image,time_utc,UnixTime,UTCAtExposure,GPSLatitude,GPSLongitude,GPSAltitude,"
        "GimbalRollDegree,GimbalPitchDegree,GimbalYawDegree",
        lambda k: (
            f"IMG_{k}.JPG,{DAY}T10:00:0{k}.5Z,{UNIX_S + k}.5,2026:05:06 10:00:0{k}.250000,"
            f"[47; 18; 203{k}/50],300034/{100 + k},{1500 + k}/1,0.0,-90.0,+{k}2.5"
        ),
    ),
}


def read_all_tags(path):
    """Times and positions, and gimbal angles, each of which may be refused."""
    times = with_ledger(lambda ledger: read_image_times(path, "", ledger))
    try:
        angles = with_ledger(lambda ledger: read_gimbal_orientations(path, GPST, ledger))
    except UnbendError as error:
        if error.code != "IMAGES-NO-GIMBAL":
            raise
        angles = None
    return times.time_ns, times.position, times.sigma_s, angles


RATIONALS = (
    (0, 0), (1, 0), (0, 1), (2**32 - 1, 1), (2**32 - 1, 2**32 - 1), (1, 2**32 - 1), (47, 1),
)  # fmt: skip
TEXTS = (
    b"2026:05:06 12:00:00\0",
    b"0000:00:00 00:00:00\0",
    b"9999:12:31 23:59:59\0",
    b"\0" * 20,
    b"    :  :     :  :  \0",
    b"2026:05:06 24:00:60\0",
    b"0001:01:01 00:00:00\0",
    b"\xff" * 20,
    b"9" * 1000,
    b"1",
    b"",
)


def tag(number, kind, count, content, at):
    """An entry of a directory of TIFF, and what stands behind the directories for it."""
    if len(content) <= 4:
        return struct.pack("<HHI4s", number, kind, count, content.ljust(4, b"\0")), b""
    return struct.pack("<HHII", number, kind, count, at), content


def directory(entries, begin):
    """A directory of TIFF that begins at an offset, and its contents."""
    head = struct.pack("<H", len(entries))
    behind = b""
    offset = begin + 2 + 12 * len(entries) + 4
    for number, kind, count, content in entries:
        entry, more = tag(number, kind, count, content, offset + len(behind))
        head += entry
        behind += more
    return head + bytes(4) + behind


def rationals(count, draw):
    values = [draw.choice(RATIONALS) for _ in range(count)]
    return b"".join(struct.pack("<II", *value) for value in values)


XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-'
    'syntax-ns#"><rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
    'drone-dji:UTCAtExposure="2026:05:06 08:20:30.123456" drone-dji:AbsoluteAltitude="+1500.5" '
    'drone-dji:GimbalRollDegree="+0.10" drone-dji:GimbalPitchDegree="-90.00" '
    'drone-dji:GimbalYawDegree="+12.30" drone-dji:GpsLatitude="47.30" '
    'drone-dji:GpsLongitude="8.50"/></rdf:RDF></x:xmpmeta>'
)


def write_images(folder, draw):
    """Five JPEGs whose tags of EXIF and XMP are at their limits."""
    for k in range(5):
        original = draw.choice(TEXTS)
        exif = [
            (0x9003, 2, len(original), original),
            (0x9291, 2, 3, draw.choice((b"25\0", b"99\0", b"x\0\0", b"\xff\xff\xff"))),
            (0x9011, 2, 7, draw.choice((b"+02:00\0", b"+99:99\0", b"-00:00\0", b"\0" * 7))),
            (0x920A, 5, 1, rationals(1, draw)),
        ]
        gps = [
            (1, 2, 2, b"N\0"),
            (2, 5, 3, rationals(3, draw)),
            (3, 2, 2, b"E\0"),
            (4, 5, 3, rationals(3, draw)),
            (5, 1, 1, bytes([draw.choice((0, 1, 255))])),
            (6, 5, 1, rationals(1, draw)),
            (7, draw.choice((5, 5, 10, 2)), 3, rationals(3, draw)),
            (29, 2, 11, draw.choice((b"2026:05:06\0", b"0000:00:00\0", b"9999:99:99\0"))),
        ]
        first = 8 + 2 + 2 * 12 + 4
        of_exif = directory(exif, first)
        of_gps = directory(gps, first + len(of_exif))
        pointers = struct.pack("<HHII", 0x8769, 4, 1, first)
        pointers += struct.pack("<HHII", 0x8825, 4, 1, first + len(of_exif))
        tiff = b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", 2) + pointers + bytes(4)
        body = b"Exif\0\0" + tiff + of_exif + of_gps
        packet = b"http://ns.adobe.com/xap/1.0/\0"
        packet += extreme_fields(XMP, draw).encode()[:60_000]
        segments = b""
        for segment in (body, packet):
            segments += b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment
        (folder / f"IMG_{k}.JPG").write_bytes(b"\xff\xd8" + segments + b"\xff\xda\0\2\xff\xd9")


TAGS = {
    name: of_texts({"tags.csv": text}, lambda folder: read_all_tags(folder / "tags.csv"))
    for name, text in TAG_ROWS.items()
} | {"tags of images": Reader(write_images, read_all_tags)}
