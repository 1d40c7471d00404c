"""Inputs beside the log by kind: how one is written with fields at their limits, its reader."""

from __future__ import annotations

import random
import struct
import tempfile
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyproj
import yaml
from pydantic import BaseModel
from scipy.io import netcdf_file

from tests.config import test_mission_file as missions
from tests.dbat_project import write_project
from tests.faults.extreme_inputs import (
    WORDS,
    Reader,
    extreme_fields,
    extreme_number,
    extreme_numbers,
    of_texts,
    with_ledger,
)
from tests.small_block import SmallBlock
from unbend.atmosphere.surface_report import parse_metar
from unbend.config import load_mission
from unbend.config.campaign import open_configs
from unbend.errors import UnbendError
from unbend.messages import Ledger
from unbend.tables.geodata.geoid import read_geoid
from unbend.tables.geodata.object_points import read_object_points
from unbend.tables.imports import blocks
from unbend.tables.imports.camera_events import read_eo_text, read_mrk
from unbend.tables.imports.exif import read_gimbal_orientations, read_image_times
from unbend.tables.imports.rtklib import read_pos
from unbend.tables.imports.sbet import read_sbet
from unbend.tables.imports.stated import Stated
from unbend.tables.imports.user_tables import (
    read_events,
    read_known_positions,
    read_orientation,
    read_trajectory_csv,
)
from unbend.tables.observations import open_observations
from unbend.tables.soundings import read_sounding
from unbend.tables.weather_files import FlightArea, contents_of, read_model_field

SOUNDINGS = Path(__file__).resolve().parents[1] / "data" / "sounding_files"
ROWS = range(8)
WEEK = 2417
TOW = 302_400  # seconds of the week: 2026-05-06, 12:00
UNIX_S = 1_778_068_782  # the same moment, UTC
NOON_NS = UNIX_S * 10**9
DAY = "2026-05-06"


def table(head: str, row: Callable[[int], str]) -> str:
    """The text of a table with `ROWS`."""
    return "\n".join([head, *(row(k) for k in ROWS)]) + "\n"


# Tables of trajectories, orientations, events and points

PLACE_COLUMNS = {"latitude": "lat", "longitude": "lon", "height": "h"}
ATTITUDE = {"roll": "r", "pitch": "p", "yaw": "y"}
GPST = Stated(time_system="gpst", heights="ellipsoid", around_ns=(NOON_NS, NOON_NS + 10**11))
UTC = Stated(time_system="utc", heights="msl", around_ns=(NOON_NS, NOON_NS + 10**11))


def trajectory(
    head: str, row: Callable[[int], str], columns: dict[str, str], stated: Stated
) -> Reader:
    """A trajectory as CSV; ``row`` writes what stands before the place and the attitude."""
    own = {"time": "t", **columns}
    text = table(head, row)

    def read(folder: Path) -> object:
        own_stated = replace(stated, columns=own)
        return with_ledger(
            lambda ledger: read_trajectory_csv(folder / "flight.csv", own_stated, ledger)
        )

    return of_texts({"flight.csv": text}, read)


def place(k: int) -> str:
    return f"{47.3 + 1e-4 * k:.6f},{8.5 + 2e-4 * k:.6f},{1500.0 + k:.2f}"


TRAJECTORIES = {
    "trajectory by dates": trajectory(
        "t,lat,lon,h,r,p,y,vn,sh",
        lambda k: f"{DAY}T12:00:{k:02d}.25Z,{place(k)},1.5,-2.0,{10 * k}.5,40.1,0.05",
        PLACE_COLUMNS | ATTITUDE | {"v_north_m_s": "vn", "sigma_h_m": "sh"},
        UTC,
    ),
    "trajectory by week and seconds": trajectory(
        "w,t,lat,lon,h,qw,qx,qy,qz",
        lambda k: f"{WEEK},{TOW + k}.5,{place(k)},0.8,0.6,0.0,0.0",
        PLACE_COLUMNS | {"week": "w", "q_w": "qw", "q_x": "qx", "q_y": "qy", "q_z": "qz"},
        GPST,
    ),
    "trajectory by seconds of the week": trajectory(
        "t,lat,lon,h", lambda k: f"{TOW + k}.5,{place(k)}", PLACE_COLUMNS, GPST
    ),
    "trajectory by Unix seconds": trajectory(
        "t,lat,lon,h", lambda k: f"{UNIX_S + k}.5,{place(k)}", PLACE_COLUMNS, UTC
    ),
    "trajectory by GPS seconds": trajectory(
        "t,lat,lon,h", lambda k: f"{604_800 * WEEK + TOW + k}.5,{place(k)}", PLACE_COLUMNS, GPST
    ),
    "trajectory earth-centred": trajectory(
        "t,x,y,z",
        lambda k: f"{UNIX_S + k}.5,{4285000.0 + k},{640400.5 + k},{4665000.25 + k}",
        {"x": "x", "y": "y", "z": "z"},
        UTC,
    ),
    "trajectory on a grid": trajectory(
        "t,x,y,h,r,p,y2",
        lambda k: f"{UNIX_S + k}.5,{465000.5 + k},{5238000.5 + k},{1500 + k}.5,1.5,2.5,{10 * k}.5",
        {"longitude": "x", "latitude": "y", "height": "h", "roll": "r", "pitch": "p", "yaw": "y2"},
        Stated(time_system="utc", heights="ellipsoid", crs="EPSG:32632"),
    ),
}

POS_HEAD = (
    "% program   : RTKPOST\n% ref pos   :  47 30 00.0000    8 30 00.0000   450.0000\n"
    "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,ns=# of satellites)\n%  GPST  "
)
POS_TAIL = "Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio"
POS_SIGMAS = "1  12   0.0110   0.0070   0.0210   0.0010  -0.0020   0.0030   0.00    9.9"


def pos(titles: str, row: Callable[[int], str]) -> Reader:
    text = table(POS_HEAD + titles + POS_TAIL, lambda k: f"{row(k)} {POS_SIGMAS}")
    return of_texts(
        {"flight.pos": text},
        lambda folder: with_ledger(
            lambda ledger: read_pos(folder / "flight.pos", Stated(), ledger)
        ),
    )


def clock(k: int) -> str:
    return f"2026/05/06 12:00:{k:02d}.250"


SOLUTIONS = {
    "pos by dates": pos(
        "latitude(deg) longitude(deg) height(m) ",
        lambda k: f"{clock(k)} {47.3 + 1e-4 * k:.9f} {8.5:.9f} {1500.0 + k:.4f}",
    ),
    "pos by weeks": pos(
        "latitude(deg) longitude(deg) height(m) ",
        lambda k: f"{WEEK} {TOW + k}.250 {47.3 + 1e-4 * k:.9f} {8.5:.9f} {1500.0 + k:.4f}",
    ),
    "pos in minutes": pos(
        "latitude(d'\") longitude(d'\") height(m) ",
        lambda k: f"{clock(k)} 47 18 {k}.0000 8 30 {k}.5000 {1500.0 + k:.4f}",
    ),
    "pos earth-centred": pos(
        "x-ecef(m) y-ecef(m) z-ecef(m) ",
        lambda k: f"{clock(k)} {4285000.0 + k:.4f} {640400.5:.4f} {4665000.25:.4f}",
    ),
    "pos as baselines": pos(
        "e-baseline(m) n-baseline(m) u-baseline(m) ",
        lambda k: f"{clock(k)} {10.5 + k:.4f} {-20.5:.4f} {1000.25:.4f}",
    ),
}

MRK_TEXT = "".join(
    f"{k + 1}\t{TOW + k}.123456\t[{WEEK}]\t   -40,N\t    12,E\t   186,V\t{47.3 + 1e-4 * k:.8f},Lat"
    f"\t{8.5:.8f},Lon\t{1500.0 + k:.3f},Ellh\t0.012000, 0.016000, 0.031000\t50,Q\n"
    for k in ROWS
)
EO_TEXT = table(
    "POS/AV Computed Data at Camera Perspective Centre\n"
    "  Grid: Universal Transverse Mercator; Zone:  UTM North 32 (006E to 012E) ;\n"
    "  Kappa cardinal rotation: 90 deg\nShift values: X = 0.0 m, Y = 0.0 m, Z = 0.0 m\n"
    "  (position in Meters, orientation in Degrees, lat, long in Deg)\n\n"
    "ID\t# EVENT\tTIME (s)\tEASTING\tNORTHING\tELLIPSOID HEIGHT\tOMEGA\tPHI\tKAPPA\tLAT\tLONG",
    lambda k: (
        f"img_{k:03d}\t{k + 1}\t{TOW + k}.500000\t465000.1\t5238000.2\t{1500 + k}.125\t-1.05\t0.32"
        f"\t179.18\t{47.3 + 1e-4 * k:.9f}\t{8.5:.9f}"
    ),
)


def events_of(name: str, text: str, read: Callable[..., object]) -> Reader:
    return of_texts(
        {name: text},
        lambda folder: with_ledger(lambda ledger: read(folder / name, GPST, ledger)),
    )


OPK = {"omega": "o", "phi": "p", "kappa": "k"}


def orientation(text: str, columns: dict[str, str], unit: Any = "deg") -> Reader:
    stated = Stated(columns={"image": "image", **columns}, angle_unit=unit)
    return of_texts(
        {"block.csv": text},
        lambda folder: with_ledger(
            lambda ledger: read_orientation(folder / "block.csv", stated, ledger)
        ),
    )


ORIENTATIONS = {
    "orientations by dates": orientation(
        table(
            "image,lat,lon,h,o,p,k,t,sh,st",
            lambda k: f"IMG_{k}.JPG,{place(k)},1.0,-2.0,9{k}.5,{DAY}T12:00:0{k}.5Z,0.05,0.01",
        ),
        PLACE_COLUMNS | OPK | {"time_utc": "t", "sigma_height_m": "sh", "sigma_tilt": "st"},
    ),
    "orientations by weeks": orientation(
        table(
            "image,x,y,z,q_w,q_x,q_y,q_z,w,s",
            lambda k: (
                f"IMG_{k}.JPG,{465000.5 + k},{5238000.5},{1500 + k}.5,0.8,0.6,0,0,{WEEK},"
                f"{TOW + k}.5"
            ),
        ),
        {name: name for name in ("x", "y", "z", "q_w", "q_x", "q_y", "q_z")}
        | {"gps_week": "w", "gps_seconds": "s"},
    ),
    "orientations in minutes": orientation(
        table(
            "image,lat,lon,h,o,p,k",
            lambda k: f"IMG_{k}.JPG,47 deg 18' {k}.5\" N,8:30:0{k}.5,1500.5,1.0,-2.0,9{k}.5",
        ),
        PLACE_COLUMNS | OPK,
    ),
}


def read_tables(reader: Callable[[Path, dict[str, str]], object], columns: dict[str, str]) -> Any:
    return lambda folder: reader(folder / "table.csv", columns)


EVENTS = {
    "events by dates": of_texts(
        {"table.csv": table("i,t", lambda k: f"IMG_{k},{DAY}T12:00:0{k}.5+02:00")},
        lambda folder: with_ledger(
            lambda ledger: read_events(
                folder / "table.csv", {"image": "i", "time_utc": "t"}, ledger
            )
        ),
    ),
    "events by weeks": of_texts(
        {"table.csv": table("i,w,s", lambda k: f"IMG_{k},{WEEK},{TOW + k}.5")},
        lambda folder: with_ledger(
            lambda ledger: read_events(
                folder / "table.csv",
                {"image": "i", "gps_week": "w", "gps_seconds": "s"},
                ledger,
            )
        ),
    ),
    "known positions": of_texts(
        {"table.csv": table("i,lat,lon,h", lambda k: f"IMG_{k},{place(k)}")},
        lambda folder: read_known_positions(folder / "table.csv", {"image": "i", **PLACE_COLUMNS}),
    ),
    "object points": of_texts(
        {"table.csv": table("p,x,y,h", lambda k: f"{k},{465000.5 + k},{5238000.5},{500 + k}.5")},
        lambda folder: read_object_points(
            folder / "table.csv", {"point": "p", "x": "x", "y": "y", "height": "h"}, key="key"
        ),
    ),
}

# Observations

OBSERVATION_NAMES = {
    "image": "image", "point": "point", "x_px": "x_px", "y_px": "y_px", "distance_m": "d",
}  # fmt: skip
OBSERVATIONS_CSV = table(
    "image,point,x_px,y_px,d,h_g_m,s,flown",
    lambda k: f"IMG_{k}.JPG,{k},{100 + k}.25,{200 + k}.5,{1000 + k}.5,{500 + k},0.5,{DAY}",
)
COLUMN_TYPES = (
    pa.int64(), pa.uint64(), pa.float32(), pa.float64(), pa.float16(), pa.string(), pa.bool_(),
    pa.decimal128(38, 0), pa.decimal256(76, 0), pa.timestamp("ms"), pa.timestamp("ns"), pa.date32(),
    pa.duration("ms"), pa.int8(), pa.null(),
)  # fmt: skip


def read_observations(path: Path) -> object:
    def read(ledger: Ledger) -> object:
        opened = open_observations(
            path, OBSERVATION_NAMES, "h_g_m", ledger, sigma_column="s", most_rows=5
        )
        batches = [*opened.batches(1000)]
        opened.sampled(points=True)
        return [(batch.x_px, batch.y_px, batch.ground, batch.distance_m) for batch in batches]

    return with_ledger(read)


def extreme_column(kind: pa.DataType, count: int, draw: random.Random) -> pa.Array:
    """A column of a type with values at its limits."""
    if pa.types.is_null(kind):
        return pa.nulls(count)
    if pa.types.is_boolean(kind) or pa.types.is_string(kind):
        values = [draw.choice((True, False, None)) for _ in range(count)]
        return pa.array(values, pa.bool_()).cast(kind)
    if pa.types.is_decimal(kind):
        digits = kind.precision
        values = [draw.choice((0, -1, 10**digits - 1, 1 - 10**digits, None)) for _ in range(count)]
        return pa.array([None if v is None else Decimal(v) for v in values], kind)
    if pa.types.is_floating(kind):
        dtype = kind.to_pandas_dtype()
        numbers = [extreme_number(np.dtype(dtype), draw) for _ in range(count)]
        return pa.array(np.array(numbers, dtype), kind)
    if pa.types.is_temporal(kind):
        bits = 32 if pa.types.is_date32(kind) else 64
        limits = np.iinfo(f"i{bits // 8}")
        values = [draw.choice((limits.min, limits.max, 0, -1)) for _ in range(count)]
        return pa.array(np.array(values, limits.dtype)).view(kind)
    dtype = np.dtype(kind.to_pandas_dtype())
    return pa.array([extreme_number(dtype, draw) for _ in range(count)], kind)


def write_parquet(name: str, sound: dict[str, Any]) -> Callable[[Path, random.Random], None]:
    """Writes a table one of whose columns has another type and values at its limits."""

    def write(folder: Path, draw: random.Random) -> None:
        columns = {key: pa.array(values) for key, values in sound.items()}
        for key in draw.sample(list(columns), draw.choice((1, 1, 2))):
            columns[key] = extreme_column(draw.choice(COLUMN_TYPES), len(ROWS), draw)
        pq.write_table(pa.table(columns), folder / name, coerce_timestamps=None)

    return write


OBSERVATIONS = {
    "observations as CSV": of_texts(
        {"o.csv": OBSERVATIONS_CSV}, lambda folder: read_observations(folder / "o.csv")
    ),
    "observations as Parquet": Reader(
        write_parquet(
            "o.parquet",
            {
                "image": [f"IMG_{k}.JPG" for k in ROWS],
                "point": [f"{k}" for k in ROWS],
                **{name: [100.5 + k for k in ROWS] for name in ("x_px", "y_px", "d", "h_g_m", "s")},
                "flown": [DAY for _ in ROWS],
            },
        ),
        lambda folder: read_observations(folder / "o.parquet"),
    ),
    "object points as Parquet": Reader(
        write_parquet(
            "p.parquet",
            {
                "p": [f"{k}" for k in ROWS],
                **{name: [500.5 + k for k in ROWS] for name in ("x", "y", "h")},
            },
        ),
        lambda folder: read_object_points(
            folder / "p.parquet", {"point": "p", "x": "x", "y": "y", "height": "h"}, key="key"
        ),
    ),
}

# Blocks of other programs


def read_block(path: Path, program: str) -> object:
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
def small_blocks() -> dict[str, tuple[str, dict[str, str]]]:
    """By kind: the path in the folder that is given to the reader, and the files of a block."""
    block = SmallBlock.make()
    block.names, block.lat, block.lon, block.h = (
        block.names[:3],
        *(values[:3] for values in (block.lat, block.lon, block.h)),
    )
    block.cam_from_enu = block.cam_from_enu[:3]
    block.observations = block.observed().groupby("image").head(4)
    found = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        known = np.column_stack([block.lat, block.lon, block.h])
        for kind in ("colmap", "opensfm", "metashape", "pix4d", "blocksexchange", "dbat"):
            (folder / kind).mkdir()
        block.write_colmap(folder / "colmap")
        block.write_opensfm(folder / "opensfm")
        block.write_metashape(
            folder / "metashape" / "doc.xml",
            reference=pyproj.CRS.from_epsg(4326).to_wkt("WKT1_GDAL"),
            known=known[:, [1, 0, 2]],
        )
        block.write_pix4d(folder / "pix4d", 32632, offset=np.array([465000.0, 5238000.0, 0.0]))
        block.write_blocks_exchange(
            folder / "blocksexchange" / "block.xml", "EPSG:32632", known=known
        )
        write_project(folder / "dbat")
        for mark in ("markpts.txt", "smartpts.txt"):
            path = folder / "dbat" / mark
            path.write_text("\n".join(path.read_text().splitlines()[:40]) + "\n")
        for kind, start in {
            "colmap": ".", "opensfm": ".", "metashape": "doc.xml", "pix4d": ".",
            "blocksexchange": "block.xml", "dbat": "sxb.xml",
        }.items():  # fmt: skip
            files = {}
            for path in sorted((folder / kind).iterdir()):
                files[path.name] = path.read_text(encoding="utf-8")
            found[kind] = (start, files)
    return found


def block_kinds() -> dict[str, Reader]:
    kinds = {}
    for program, (start, files) in small_blocks().items():

        def read(folder: Path, start: str = start, program: str = program) -> object:
            return read_block(folder / start, program)

        kinds[f"block of {program}"] = of_texts(files, read)
    return kinds


def write_colmap_binary(folder: Path, draw: random.Random) -> None:
    """A model of one camera, two images and two points; one of its numbers is at its limits."""
    parts = {
        "cameras.bin": [
            ("Q", [1]),
            ("iiQQ", [1, 1, 4000, 3000]),
            ("4d", [3000.0, 3000.0, 2000.0, 1500.0]),
        ],
        "images.bin": [("Q", [2])],
        "points3D.bin": [("Q", [2])],
    }  # fmt: skip
    for image in (1, 2):
        parts["images.bin"] += [
            ("i7di", [image, 0.8, 0.6, 0.0, 0.0, 1.0, 2.0, 3.0, 1]),
            ("6s", [b"a%d.jp\0" % image]),
            ("Q", [2]),
            ("2dq", [100.5, 200.5, 1]),
            ("2dq", [300.5, 400.5, -1]),
        ]
        parts["points3D.bin"] += [
            ("Q3d3BdQ", [image, 1.0, 2.0, 3.0, 1, 2, 3, 0.5, 1]), ("ii", [1, 0]),
        ]  # fmt: skip
    spoilt = draw.choice(list(parts))
    record = draw.randrange(len(parts[spoilt]))
    for name, records in parts.items():
        content = b""
        for number, (form, values) in enumerate(records):
            letters = expanded(form)
            numbers = list(values)
            if name == spoilt and number == record and "s" not in form:
                at = draw.randrange(len(numbers))
                kind = np.dtype(letters[at].replace("q", "i8").replace("Q", "u8"))
                numbers[at] = extreme_number(kind, draw).item()
            content += struct.pack("<" + form, *numbers)
        (folder / name).write_bytes(content)


def expanded(form: str) -> str:
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


def read_all_tags(path: Path) -> object:
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
    b"2026:05:06 12:00:00\0", b"0000:00:00 00:00:00\0", b"9999:12:31 23:59:59\0", b"\0" * 20,
    b"    :  :     :  :  \0", b"2026:05:06 24:00:60\0", b"0001:01:01 00:00:00\0", b"\xff" * 20,
    b"9" * 1000, b"1", b"",
)  # fmt: skip


def tag(number: int, kind: int, count: int, content: bytes, at: int) -> tuple[bytes, bytes]:
    """An entry of a directory of TIFF, and what stands behind the directories for it."""
    if len(content) <= 4:
        return struct.pack("<HHI4s", number, kind, count, content.ljust(4, b"\0")), b""
    return struct.pack("<HHII", number, kind, count, at), content


def directory(entries: list[tuple[int, int, int, bytes]], begin: int) -> bytes:
    """A directory of TIFF that begins at an offset, and its contents."""
    head = struct.pack("<H", len(entries))
    behind = b""
    at = begin + 2 + 12 * len(entries) + 4
    for number, kind, count, content in entries:
        entry, more = tag(number, kind, count, content, at + len(behind))
        head += entry
        behind += more
    return head + bytes(4) + behind


def rationals(count: int, draw: random.Random) -> bytes:
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


def write_images(folder: Path, draw: random.Random) -> None:
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

# The weather

RISE = np.arange(0.0, 6000.0, 500.0)
CELSIUS = 15.0 - 0.0065 * RISE
HECTOPASCALS = 1013.25 * ((CELSIUS + 273.15) / 288.15) ** 5.255877
PLAIN_SOUNDING = "h_m,pressure_hpa,temperature_c,dew_point_c,time_utc,latitude_deg,longitude_deg\n"
for _h, _p, _t in zip(RISE, HECTOPASCALS, CELSIUS, strict=True):
    PLAIN_SOUNDING += f"{_h:.1f},{_p:.2f},{_t:.2f},{_t - 5.0:.2f},{DAY}T12:00:00Z,47.5,8.5\n"
WYOMING_LIST = """72357 OUN Norman Observations at 12Z 06 May 2026

-----------------------------------------------------------------------------
   PRES   HGHT   TEMP   DWPT   RELH   MIXR   DRCT   SKNT   THTA   THTE   THTV
    hPa     m      C      C      %    g/kg    deg   knot     K      K      K
-----------------------------------------------------------------------------
"""
for _h, _p, _t in zip(RISE, HECTOPASCALS, CELSIUS, strict=True):
    WYOMING_LIST += f"{_p:7.1f}{_h:7.0f}{_t:7.1f}{_t - 5.0:7.1f}{70:7d}\n"
WYOMING_LIST += """
Station information and sounding indices
                         Station identifier: OUN
                             Station number: 72357
                           Observation time: 260506/1200
                           Station latitude: 35.18
                          Station longitude: -97.44
                          Station elevation: 345.0
"""
REPORT = "METAR LOWW 061150Z 24011KT 9999 SCT040 M05/M10 Q1013 A2992 NOSIG RMK T10521098"


def sounding_of(text: str, format_name: str = "auto") -> Reader:
    def read(folder: Path) -> object:
        return with_ledger(
            lambda ledger: read_sounding(
                folder / "s.txt",
                ledger,
                format_name=format_name,
                time_ns=NOON_NS,
                latitude_rad=0.8,
                station_h_m=100.0,
            )
        )

    return of_texts({"s.txt": text}, read)


def head_of(name: str, lines: int = 30) -> str:
    text = next(SOUNDINGS.glob(name)).read_text(encoding="utf-8")
    return "\n".join(text.splitlines()[:lines]) + "\n"


def write_arm(folder: Path, draw: random.Random) -> None:
    """The netCDF of a radiosonde, one of whose variables is at its limits."""
    size = RISE.size
    columns = {
        "base_time": np.array(UNIX_S, "i4"),
        "time_offset": np.arange(size) * 60.0,
        "lat": np.full(size, 36.6, "f4"),
        "lon": np.full(size, -97.5, "f4"),
        "pres": HECTOPASCALS,
        "tdry": CELSIUS,
        "dp": CELSIUS - 5.0,
        "rh": np.full(size, 70.0),
        "alt": RISE,
    }
    for name in draw.sample(list(columns), 2):
        kind = columns[name].dtype if draw.random() < 0.7 else np.dtype(draw.choice(("f8", "i4")))
        values = columns[name].astype(kind)
        if values.ndim:
            rows = draw.choice((slice(None), draw.randrange(size)))
            values[rows] = extreme_number(kind, draw)
        else:
            values = np.array(extreme_number(kind, draw), kind)
        columns[name] = values
    with netcdf_file(folder / "sonde.cdf", "w") as file:
        file.createDimension("time", size)
        for name, values in columns.items():
            on = ("time",) if values.ndim else ()
            variable = file.createVariable(name, values.dtype, on)
            variable[...] = values


WEATHER_NAMES = ("valid_time", "pressure_level", "latitude", "longitude", "t", "q", "z")
TIME_UNITS = (
    "seconds since 1970-01-01", "hours since 1900-01-01", "days since 0001-01-01",
    "days since 9999-12-31", "years since 2000-01-01", "nanoseconds since 1970-01-01", "x since y",
    "days since 2026-02-30", "seconds since 0000-01-01", "months since 1970-01-01", "hours",
)  # fmt: skip


def write_model(folder: Path, draw: random.Random) -> None:
    """The netCDF of a weather model, two of whose variables are at their limits."""
    levels = np.array([1000.0, 925.0, 850.0, 700.0, 500.0, 300.0])
    height = 44330.0 * (1.0 - (levels / 1013.25) ** 0.19)
    shape = (3, levels.size, 3, 3)
    on_levels = np.ones(shape) * (288.15 - 0.0065 * height)[:, None, None]
    columns = {
        "valid_time": (UNIX_S - 3600 * np.array([1, 0, -1])).astype(draw.choice(("i4", "f8"))),
        "pressure_level": levels,
        "latitude": np.array([47.5, 47.25, 47.0]),
        "longitude": np.array([8.25, 8.5, 8.75]),
        "t": on_levels,
        "q": np.full(shape, 0.003),
        "z": np.ones(shape) * (9.80665 * height)[:, None, None],
    }
    units = {
        "valid_time": "seconds since 1970-01-01", "pressure_level": "hPa", "t": "K",
        "q": "kg kg**-1", "z": "m**2 s**-2",
    }  # fmt: skip
    for name in draw.sample(WEATHER_NAMES, draw.choice((1, 1, 2))):
        columns[name] = extreme_numbers(columns[name], draw)
    if draw.random() < 0.2:
        units["valid_time"] = draw.choice(TIME_UNITS)
    dimensions = {name: columns[name].size for name in WEATHER_NAMES[:4]}
    with netcdf_file(folder / "model.nc", "w", version=2) as file:
        for name, size in dimensions.items():
            file.createDimension(name, size)
        for name, values in columns.items():
            variable = file.createVariable(name, values.dtype, (name,) if values.ndim == 1 else
                                           WEATHER_NAMES[:4])  # fmt: skip
            variable[...] = values
            if name in units:
                variable.units = units[name]


def read_model(folder: Path) -> object:
    path = folder / "model.nc"
    area = FlightArea(
        np.radians([47.2, 47.3]), np.radians([8.4, 8.6]), np.array([NOON_NS, NOON_NS + 10**9])
    )
    contents_of(path)
    return with_ledger(lambda ledger: read_model_field(path, area, ledger))


WEATHER = {
    "sounding as CSV": sounding_of(PLAIN_SOUNDING),
    "sounding as Wyoming's list": sounding_of(WYOMING_LIST),
    "sounding as Wyoming's page": sounding_of(
        head_of("metpy*").replace("#", "72357 OUN Observations at 12Z 06 May 2026\n#", 1),
        "wyoming_list",
    ),
    "sounding as Wyoming's CSV": sounding_of(head_of("wyoming_csv_OUN*")),
    "sounding of IGRA": sounding_of(head_of("igra2_USM*")),
    "sounding of IGRA, derived": sounding_of(head_of("igra2_derived*")),
    "sounding as netCDF": Reader(
        write_arm,
        lambda folder: with_ledger(
            lambda ledger: read_sounding(folder / "sonde.cdf", ledger, time_ns=NOON_NS)
        ),
    ),
    "METAR": of_texts(
        {"m.txt": f"2026/05/06 11:50 {REPORT}"},
        lambda folder: with_ledger(
            lambda ledger: parse_metar(
                (folder / "m.txt").read_text(encoding="utf-8"), 183.0, ledger, flight_ns=NOON_NS
            )
        ),
    ),
    "weather model": Reader(write_model, read_model),
}

# Grids


def write_gtx(folder: Path, draw: random.Random) -> None:
    """A geoid whose head or values are at their limits."""
    head = np.array([46.0, 7.0, 0.25, 0.25])
    size = np.array([5, 6], "i4")
    values = np.full((5, 6), 47.5, "f4")
    what = draw.choice("hsv")
    if what == "h":
        head = extreme_numbers(head, draw)
    elif what == "s":
        size = extreme_numbers(size, draw)
    else:
        values = extreme_numbers(values, draw)
    content = head.astype(">f8").tobytes() + size.astype(">i4").tobytes()
    (folder / "g.gtx").write_bytes(content + values.astype(">f4").tobytes())


def read_gtx(folder: Path) -> object:
    grid = read_geoid(folder / "g.gtx")
    return grid.undulation(np.radians([46.5, -89.0]), np.radians([8.0, 179.0]))


def write_doubles(name: str, width: int, row: Callable[[int], list[float]]) -> Any:
    """Writes rows of doubles, as SBET and smrmsg are, with some at their limits."""

    def write(folder: Path, draw: random.Random) -> None:
        values = np.array([row(k) for k in range(20)])
        (folder / name).write_bytes(extreme_numbers(values, draw).astype("<f8").tobytes())

    return write


def sbet_row(k: int) -> list[float]:
    return [
        TOW + 0.1 * k, 0.8255, 0.1484 + 1e-7 * k, 1500.0, 0.0, 4.5, 0.0, 0.01, 0.02, 1.5, 0.001,
        0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
    ]  # fmt: skip


def write_smrmsg(folder: Path, draw: random.Random) -> None:
    sound = np.array([sbet_row(k) for k in range(20)])
    (folder / "sbet.out").write_bytes(sound.astype("<f8").tobytes())
    rows = np.array([[TOW + 0.2 * k, *[0.03] * 6, 0.6, 0.8, 3.0] for k in range(-2, 20)])
    (folder / "sigmas.out").write_bytes(extreme_numbers(rows, draw).astype("<f8").tobytes())


def read_sbet_of(folder: Path, accuracy: str = "") -> object:
    stated = replace(GPST, accuracy=folder / accuracy) if accuracy else GPST
    return with_ledger(lambda ledger: read_sbet(folder / "sbet.out", stated, ledger))


BINARY = {
    "block of colmap, binary": Reader(
        write_colmap_binary, lambda folder: read_block(folder, "colmap")
    ),
    "geoid": Reader(write_gtx, read_gtx),
    "SBET": Reader(write_doubles("sbet.out", 17, sbet_row), read_sbet_of),
    "smrmsg": Reader(write_smrmsg, lambda folder: read_sbet_of(folder, "sigmas.out")),
}

# Mission files

YAML_WORDS = (
    ".inf", "-.inf", ".nan", "1e400", "-1e400", "0x10", "1_000", "~", "!!bool x", "!!int x",
    "!!float x", "!!timestamp x", "!!timestamp 0001-01-01T00:00:00+23:59", "!!binary x", "!!set x",
    "!!omap [1]", "!!python/object:os.system x", "&loop [*loop]", "&loop {a: *loop}",
    "&loop {<<: *loop}", "*unknown", "[[[[[[]]]]]]", "[" * 3000, "{a: {a: {a: 1}}}", "9" * 5000,
    "[1.0e+308, -1.0e+308, 1.0e+308]", "[0.0, 0.0, 0.0]", "[0.0, 0.0]", "[-1.0, -1.0]",
    "- 1", "true", "2026-05-14", '"\\0"',
    "&a [&b [&c [&d [x, x, x], *d, *d, *d], *c, *c, *c], *b, *b, *b]",
)  # fmt: skip


@cache
def mission_texts() -> dict[str, str]:
    """Mission files of all kinds, written one key a line."""
    kinds = {
        "full": missions.FULL,
        "events": missions.with_csv_events(),
        "oriented": missions.ORIENTED,
        "projected": missions.oriented(missions.PROJECTED),
        "topocentric": missions.oriented(missions.TOPOCENTRIC),
    }
    for number, values in enumerate(missions.with_imports()):
        kinds[f"imports {number}"] = values
    return {
        name: yaml.dump(values, Dumper=_without_aliases(), sort_keys=False, width=10_000)
        for name, values in kinds.items()
    }


def _without_aliases() -> Any:
    class Dumper(yaml.SafeDumper):
        def ignore_aliases(self, data: Any) -> bool:
            return True

    return Dumper


def extreme_mission(text: str, draw: random.Random) -> str:
    """A mission file one to three of whose values are at their limits."""
    lines = text.splitlines()
    for _ in range(draw.choice((1, 1, 1, 3))):
        row = draw.randrange(len(lines))
        key, colon, value = lines[row].partition(": ")
        if colon and value:
            word = draw.choice((*YAML_WORDS, *WORDS))
            if word in WORDS and draw.random() < 0.3:
                word = f'"{word}"'
            lines[row] = f"{key}: {word}"
        elif lines[row].lstrip().startswith("- "):
            indent = lines[row].partition("- ")[0]
            lines[row] = f"{indent}- {draw.choice((*YAML_WORDS, *WORDS))}"
    return "\n".join(lines) + "\n"


def write_mission(folder: Path, draw: random.Random) -> None:
    texts = mission_texts()
    text = texts[draw.choice(list(texts))]
    (folder / "mission.yaml").write_text(extreme_mission(text, draw), encoding="utf-8")


def write_campaign(folder: Path, draw: random.Random) -> None:
    """A campaign with defaults and a mission that stands in its file."""
    texts = mission_texts()
    text = extreme_mission(texts["full"], draw)
    inside = "\n".join(f"    {line}" for line in text.splitlines())
    name = draw.choice((*YAML_WORDS, *WORDS, "*.yaml", "a.yaml"))
    content = f"campaign: c\ndefaults:\n{inside}\nmissions:\n- mission: {{name: a}}\n- {name}\n"
    (folder / "campaign.yaml").write_text(content, encoding="utf-8")


def derived_values(section: object) -> None:
    """Ask a section, and those in it, for all that follows from its values."""
    if isinstance(section, dict):
        for inner in section.values():
            derived_values(inner)
    elif isinstance(section, list | tuple):
        for inner in section:
            derived_values(inner)
    elif isinstance(section, BaseModel):
        for name in vars(type(section)):
            kind = vars(type(section))[name]
            if not name.startswith("_") and isinstance(kind, property | cached_property):
                ask(section, name)
        for name in type(section).model_fields:
            derived_values(getattr(section, name))


def ask(section: object, name: str) -> None:
    """Compute a property; that of a camera in a file, which is not there, cannot be."""
    try:
        getattr(section, name)
    except ValueError as error:
        if "has not been read" not in str(error):
            raise


def read_mission(folder: Path) -> None:
    derived_values(load_mission(folder / "mission.yaml"))


def read_campaign(folder: Path) -> None:
    missions, _ = open_configs([folder / "campaign.yaml"])
    for mission in missions:
        derived_values(mission.load())


MISSIONS = {
    "mission file": Reader(write_mission, read_mission),
    "campaign file": Reader(write_campaign, read_campaign),
}

READERS: dict[str, Reader] = {
    **TRAJECTORIES,
    **SOLUTIONS,
    "MRK": events_of("flight.MRK", MRK_TEXT, read_mrk),
    "EO": events_of("eo.txt", EO_TEXT, read_eo_text),
    **ORIENTATIONS,
    **EVENTS,
    **OBSERVATIONS,
    **block_kinds(),
    **TAGS,
    **WEATHER,
    **BINARY,
    **MISSIONS,
}
