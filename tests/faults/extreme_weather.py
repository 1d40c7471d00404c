"""Soundings, reports, weather models and geoids with fields at their limits."""

from functools import cache
from pathlib import Path

import numpy as np
from scipy.io import netcdf_file
from xarray import Dataset

from tests import model_files
from tests.faults.extreme_inputs import (
    Reader,
    extreme_number,
    extreme_numbers,
    of_text,
    with_ledger,
)
from tests.faults.extreme_tables import DAY, NOON_NS, UNIX_S
from tests.tables.arm_sounding import CELSIUS, HECTOPASCAL, HEIGHT, VARIABLES, write_arm
from tests.tables.test_model_fields import still_air
from unbend.atmosphere.surface_report import parse_metar
from unbend.tables.geodata.geoid import read_geoid
from unbend.tables.model_fields import FlightArea, read_model_field
from unbend.tables.soundings import read_sounding
from unbend.tables.weather_files import contents_of

SOUNDINGS = Path(__file__).resolve().parents[1] / "data" / "sounding_files"
PLAIN_SOUNDING = "h_m,pressure_hpa,temperature_c,dew_point_c,time_utc,latitude_deg,longitude_deg\n"
for _h, _p, _t in zip(HEIGHT, HECTOPASCAL, CELSIUS, strict=True):
    PLAIN_SOUNDING += f"{_h:.1f},{_p:.2f},{_t:.2f},{_t - 5.0:.2f},{DAY}T12:00:00Z,47.5,8.5\n"
WYOMING_LIST = """72357 OUN Norman Observations at 12Z 06 May 2026

-----------------------------------------------------------------------------
   PRES   HGHT   TEMP   DWPT   RELH   MIXR   DRCT   SKNT   THTA   THTE   THTV
    hPa     m      C      C      %    g/kg    deg   knot     K      K      K
-----------------------------------------------------------------------------
"""
for _h, _p, _t in zip(HEIGHT, HECTOPASCAL, CELSIUS, strict=True):
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


def sounding_of(text, format_name="auto") -> Reader:
    def read(path, ledger):
        return read_sounding(
            path,
            ledger,
            format_name=format_name,
            time_ns=NOON_NS,
            latitude_rad=0.8,
            station_h_m=100.0,
        )

    return of_text("s.txt", text, read)


def head_of(name, lines=30):
    text = next(SOUNDINGS.glob(name)).read_text("utf-8")
    return "\n".join(text.splitlines()[:lines]) + "\n"


def write_extreme_arm(folder, draw):
    """The netCDF of a radiosonde, two of whose variables are at their limits."""
    columns = VARIABLES | {"base_time": np.array(UNIX_S, "i4")}
    for name in draw.sample(list(columns), 2):
        kind = columns[name].dtype if draw.random() < 0.7 else np.dtype(draw.choice(("f8", "i4")))
        values = columns[name].astype(kind)
        if values.ndim:
            rows = draw.choice((slice(None), draw.randrange(values.size)))
            values[rows] = extreme_number(kind, draw)
        else:
            values = np.array(extreme_number(kind, draw), kind)
        columns[name] = values
    write_arm(folder / "sonde.cdf", columns)


WEATHER_NAMES = ("valid_time", "pressure_level", "latitude", "longitude", "t", "q", "z")
TIME_UNITS = (
    "seconds since 1970-01-01",
    "hours since 1900-01-01",
    "days since 0001-01-01",
    "days since 9999-12-31",
    "years since 2000-01-01",
    "nanoseconds since 1970-01-01",
    "x since y",
    "days since 2026-02-30",
    "seconds since 0000-01-01",
    "months since 1970-01-01",
    "hours",
)


@cache
def weather_model() -> Dataset:
    """Still air over three by three nodes at three hours."""
    latitude_deg = (47.5, 47.25, 47.0)
    longitude_deg = (8.25, 8.5, 8.75)
    times = (f"{DAY}T{hour}:00" for hour in (11, 12, 13))
    levels = (1000, 925, 850, 700, 500, 300)
    return model_files.dataset(still_air, latitude_deg, longitude_deg, [*times], levels)


def write_model(folder, draw):
    """The netCDF of a weather model, two of whose variables are at their limits."""
    fields = weather_model()
    columns = {name: fields[name].values for name in WEATHER_NAMES}
    units = {name: fields[name].attrs["units"] for name in ("pressure_level", "t", "q", "z")}
    units["valid_time"] = "seconds since 1970-01-01"
    seconds = columns["valid_time"].astype("datetime64[s]").astype(np.int64)
    columns["valid_time"] = seconds.astype(draw.choice(("i4", "f8")))
    for name in draw.sample(WEATHER_NAMES, draw.choice((1, 1, 2))):
        columns[name] = extreme_numbers(columns[name], draw)
    if draw.random() < 0.2:
        units["valid_time"] = draw.choice(TIME_UNITS)
    dimensions = {name: columns[name].size for name in WEATHER_NAMES[:4]}
    with netcdf_file(folder / "model.nc", "w", version=2) as file:
        for name, size in dimensions.items():
            file.createDimension(name, size)
        for name, values in columns.items():
            variable = file.createVariable(
                name, values.dtype, (name,) if values.ndim == 1 else WEATHER_NAMES[:4]
            )
            variable[...] = values
            if name in units:
                variable.units = units[name]


def read_weather_model(path):
    area = FlightArea(
        np.radians([47.2, 47.3]), np.radians([8.4, 8.6]), np.array([NOON_NS, NOON_NS + 10**9])
    )
    contents_of(path)
    return with_ledger(lambda ledger: read_model_field(path, area, ledger))


def read_report(path, ledger):
    text = path.read_text("utf-8")
    return parse_metar(text, 183.0, ledger, flight_ns=NOON_NS)


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
        write_extreme_arm,
        lambda folder: with_ledger(
            lambda ledger: read_sounding(folder / "sonde.cdf", ledger, time_ns=NOON_NS)
        ),
    ),
    "METAR": of_text("m.txt", f"2026/05/06 11:50 {REPORT}", read_report),
    "weather model": Reader(write_model, lambda folder: read_weather_model(folder / "model.nc")),
}

# Grids


def write_gtx(folder, draw):
    """A geoid whose head or values are at their limits."""
    head = np.array([46.0, 7.0, 0.25, 0.25])
    size = np.array([5, 6], "i4")
    values = np.full((5, 6), 47.5, "f4")
    part = draw.choice("hsv")
    if part == "h":
        head = extreme_numbers(head, draw)
    elif part == "s":
        size = extreme_numbers(size, draw)
    else:
        values = extreme_numbers(values, draw)
    content = head.astype(">f8").tobytes() + size.astype(">i4").tobytes()
    (folder / "g.gtx").write_bytes(content + values.astype(">f4").tobytes())


def read_gtx(folder):
    grid = read_geoid(folder / "g.gtx")
    return grid.undulation(np.radians([46.5, -89.0]), np.radians([8.0, 179.0]))


GRIDS = {"geoid": Reader(write_gtx, read_gtx)}
