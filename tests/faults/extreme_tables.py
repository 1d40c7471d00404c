"""Trajectories, orientations, events, points and observations with fields at their limits."""

from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.faults.extreme_inputs import (
    Reader,
    extreme_number,
    extreme_numbers,
    of_text,
    with_ledger,
)
from tests.tables.imports.flights import Flight
from unbend.messages import Ledger
from unbend.tables.geodata.object_points import read_object_points
from unbend.tables.imports.camera_events import read_eo_text, read_mrk
from unbend.tables.imports.rtklib import read_pos
from unbend.tables.imports.sbet import read_sbet
from unbend.tables.imports.stated import Stated
from unbend.tables.imports.user_tables import (
    read_events,
    read_known_positions,
    read_orientation,
)
from unbend.tables.imports.user_trajectories import read_trajectory_csv
from unbend.tables.observations import open_observations

ROWS = range(8)
WEEK = 2417
TOW = 302_400  # seconds of the week: 2026-05-06, 12:00
UNIX_S = 1_778_068_782  # the same moment, UTC
NOON_NS = UNIX_S * 10**9
DAY = "2026-05-06"


def table(head, row: Callable[[int], str]):
    """The text of a table with `ROWS`."""
    return "\n".join([head, *(row(k) for k in ROWS)]) + "\n"


# Tables of trajectories, orientations, events and points

PLACE_COLUMNS = {"latitude": "lat", "longitude": "lon", "height": "h"}
ATTITUDE = {"roll": "r", "pitch": "p", "yaw": "y"}
GPST = Stated(time_system="gpst", heights="ellipsoid", around_ns=(NOON_NS, NOON_NS + 10**11))
UTC = Stated(time_system="utc", heights="msl", around_ns=(NOON_NS, NOON_NS + 10**11))


def trajectory(head, row: Callable[[int], str], columns, stated) -> Reader:
    """A trajectory as CSV; ``row`` writes what stands before the place and the attitude."""
    whole = replace(stated, columns={"time": "t", **columns})
    text = table(head, row)
    return of_text(
        "flight.csv", text, lambda path, ledger: read_trajectory_csv(path, whole, ledger)
    )


def place(k):
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


def pos(titles, row: Callable[[int], str]) -> Reader:
    text = table(POS_HEAD + titles + POS_TAIL, lambda k: f"{row(k)} {POS_SIGMAS}")
    return of_text("flight.pos", text, lambda path, ledger: read_pos(path, Stated(), ledger))


def clock(k):
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


def events_of(name, text, read: Callable[..., object]) -> Reader:
    return of_text(name, text, lambda path, ledger: read(path, GPST, ledger))


OPK = {"omega": "o", "phi": "p", "kappa": "k"}


def orientation(text, columns, unit="deg") -> Reader:
    stated = Stated(columns={"image": "image", **columns}, angle_unit=unit)
    return of_text("block.csv", text, lambda path, ledger: read_orientation(path, stated, ledger))


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


DATES = {"image": "i", "time_utc": "t"}
WEEKS = {"image": "i", "gps_week": "w", "gps_seconds": "s"}


def read_points(path, _: Ledger):
    columns = {"point": "p", "x": "x", "y": "y", "height": "h"}
    return read_object_points(path, columns, key="key")


EVENTS = {
    "events by dates": of_text(
        "table.csv",
        table("i,t", lambda k: f"IMG_{k},{DAY}T12:00:0{k}.5+02:00"),
        lambda path, ledger: read_events(path, DATES, ledger),
    ),
    "events by weeks": of_text(
        "table.csv",
        table("i,w,s", lambda k: f"IMG_{k},{WEEK},{TOW + k}.5"),
        lambda path, ledger: read_events(path, WEEKS, ledger),
    ),
    "known positions": of_text(
        "table.csv",
        table("i,lat,lon,h", lambda k: f"IMG_{k},{place(k)}"),
        lambda path, _: read_known_positions(path, {"image": "i", **PLACE_COLUMNS}),
    ),
    "object points": of_text(
        "table.csv",
        table("p,x,y,h", lambda k: f"{k},{465000.5 + k},{5238000.5},{500 + k}.5"),
        read_points,
    ),
}

# Observations

OBSERVATION_NAMES = {
    "image": "image",
    "point": "point",
    "x_px": "x_px",
    "y_px": "y_px",
    "distance_m": "d",
}
OBSERVATIONS_CSV = table(
    "image,point,x_px,y_px,d,h_g_m,s,flown",
    lambda k: f"IMG_{k}.JPG,{k},{100 + k}.25,{200 + k}.5,{1000 + k}.5,{500 + k},0.5,{DAY}",
)
COLUMN_TYPES = (
    pa.int64(),
    pa.uint64(),
    pa.float32(),
    pa.float64(),
    pa.float16(),
    pa.string(),
    pa.bool_(),
    pa.decimal128(38, 0),
    pa.decimal256(76, 0),
    pa.timestamp("ms"),
    pa.timestamp("ns"),
    pa.date32(),
    pa.duration("ms"),
    pa.int8(),
    pa.null(),
)


def read_observations(path, ledger):
    opened = open_observations(
        path, OBSERVATION_NAMES, "h_g_m", ledger, sigma_column="s", most_rows=5
    )
    batches = [*opened.batches(1000)]
    opened.sampled(points=True)
    return [(batch.x_px, batch.y_px, batch.ground, batch.distance_m) for batch in batches]


def extreme_column(kind: pa.DataType, count, draw) -> pa.Array:
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


def of_parquet(sound, read: Callable[[Path, Ledger], object]) -> Reader:
    """A table one of whose columns has another type and values at its limits."""

    def write(folder, draw):
        columns = {key: pa.array(values) for key, values in sound.items()}
        for key in draw.sample(list(columns), draw.choice((1, 1, 2))):
            columns[key] = extreme_column(draw.choice(COLUMN_TYPES), len(ROWS), draw)
        pq.write_table(pa.table(columns), folder / "t.parquet", coerce_timestamps=None)

    def read_folder(folder):
        return with_ledger(lambda ledger: read(folder / "t.parquet", ledger))

    return Reader(write, read_folder)


NUMBERS = [str(k) for k in ROWS]
PIXELS = [100.5 + k for k in ROWS]
METRES = [500.5 + k for k in ROWS]
OBSERVATIONS = {
    "observations as CSV": of_text("o.csv", OBSERVATIONS_CSV, read_observations),
    "observations as Parquet": of_parquet(
        {
            "image": [f"IMG_{k}.JPG" for k in ROWS],
            "point": NUMBERS,
            **dict.fromkeys(("x_px", "y_px", "d", "h_g_m", "s"), PIXELS),
            "flown": [DAY for _ in ROWS],
        },
        read_observations,
    ),
    "object points as Parquet": of_parquet(
        {"p": NUMBERS, "x": METRES, "y": METRES, "h": METRES}, read_points
    ),
}

# SBET


def write_doubles(path, values):
    """As SBET and smrmsg are."""
    path.write_bytes(values.astype("<f8").tobytes())


SBET = Flight(Path(), 0.1 * np.arange(20)).sbet_rows()
SMRMSG = np.array([[TOW + 0.2 * k, *[0.03] * 6, 0.6, 0.8, 3.0] for k in range(-2, 20)])


def write_sbet(folder, draw):
    write_doubles(folder / "sbet.out", extreme_numbers(SBET, draw))


def write_smrmsg(folder, draw):
    write_doubles(folder / "sbet.out", SBET)
    write_doubles(folder / "sigmas.out", extreme_numbers(SMRMSG, draw))


def read_sbet_of(folder, accuracy=""):
    stated = replace(GPST, accuracy=folder / accuracy) if accuracy else GPST
    return with_ledger(lambda ledger: read_sbet(folder / "sbet.out", stated, ledger))


BINARY_TABLES = {
    "SBET": Reader(write_sbet, read_sbet_of),
    "smrmsg": Reader(write_smrmsg, lambda folder: read_sbet_of(folder, "sigmas.out")),
}

TABLES: dict[str, Reader] = {
    **TRAJECTORIES,
    **SOLUTIONS,
    "MRK": events_of("flight.MRK", MRK_TEXT, read_mrk),
    "EO": events_of("eo.txt", EO_TEXT, read_eo_text),
    **ORIENTATIONS,
    **EVENTS,
    **OBSERVATIONS,
    **BINARY_TABLES,
}
