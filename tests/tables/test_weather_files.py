"""What a file of a weather model holds, by files that the tests make and by real ones."""

import json
import struct
import subprocess
import sys

import numpy as np
import pyproj  # noqa: F401  (before ecCodes)
import pytest
import xarray

from tests.conftest import run_command
from tests.helpers import one_line, refused
from tests.logs import REPOSITORY, SHARED
from tests.tables.checks import refused_with
from tests.tables.grib_messages import write_grib
from unbend.tables.weather_files import contents_of, is_model_file

TIMES = np.array(["2026-05-14T10", "2026-05-14T11"], "datetime64[ns]")


def write(path, dimensions: dict[str, int], coordinates):
    """netCDF-4 with a temperature of these dimensions."""
    t = (tuple(dimensions), np.full(tuple(dimensions.values()), 280.0), {"units": "K"})
    xarray.Dataset({"t": t}, coordinates).to_netcdf(path, engine="h5netcdf")
    return path


@pytest.fixture
def era5(tmp_path):
    """With the names of the climate data store since 2024."""
    coordinates = {
        "valid_time": TIMES,
        "pressure_level": ("pressure_level", [1000.0, 850.0, 500.0], {"units": "hPa"}),
        "latitude": [47.0, 46.5],
        "longitude": [6.5, 7.0, 7.5],
        "number": 0,
    }
    dimensions = {"valid_time": 2, "pressure_level": 3, "latitude": 2, "longitude": 3}
    return write(tmp_path / "era5.nc", dimensions, coordinates)


@pytest.fixture
def gfs(tmp_path):
    """GRIB2, temperature at two levels, from ecCodes' sample."""
    path = tmp_path / "gfs.grib2"
    write_grib(path, [f"level={level},dataDate=20260514" for level in (850, 500)])
    return path


def test_names_of_the_climate_data_store(era5):
    contents = contents_of(era5)
    assert contents["format"] == "netCDF-4"
    assert contents["grid"] == "latitude-longitude"
    assert contents["levels"] == [500.0, 850.0, 1000.0]
    assert contents["times_utc"] == ["2026-05-14T10:00", "2026-05-14T11:00"]
    assert contents["latitude_deg"] == {"from": 46.5, "to": 47.0, "step": 0.5, "count": 2}
    ended = run_command("inspect", era5)
    assert ended.code == 0
    assert "3 pressure levels, 500 to 1000 hPa" in ended.out
    assert "2026-05-14 10:00 to 2026-05-14 11:00 UTC" in ended.out


def test_pascals_and_hectopascals_are_the_same_levels(era5, tmp_path):
    level = ("pressure_level", [100_000.0, 85_000.0, 50_000.0], {"units": "Pa"})
    path = tmp_path / "pa.nc"
    with xarray.open_dataset(era5, engine="h5netcdf") as data:
        data.assign_coords(pressure_level=level).to_netcdf(path, engine="h5netcdf")
    assert contents_of(path)["levels"] == [500.0, 850.0, 1000.0]


def test_grib(gfs):
    contents = contents_of(gfs)
    assert contents["format"] == "GRIB"
    assert contents["levels"] == [500.0, 850.0]
    assert contents["times_utc"][0].startswith("2026-05-14")
    assert not list(gfs.parent.glob("*.idx"))


def test_grib_that_was_cut_off(gfs):
    whole = gfs.read_bytes()
    gfs.write_bytes(whole[:-100])
    cut = f"message 2.*the file has {len(whole) - 100} bytes"
    with refused_with("MODEL-TRUNCATED", cut):
        contents_of(gfs)
    assert run_command("inspect", gfs).code == 6


def test_lengths_of_grib_that_lead_beyond_the_file(gfs):
    whole = gfs.read_bytes()
    gfs.write_bytes(whole[:8] + b"\x80" + whole[9:])  # of a message
    with refused_with("MODEL-TRUNCATED", "message 1 at byte 0 has 9223372036854"):
        contents_of(gfs)
    first = whole.index(b"GRIB", 4) + 16  # of the first section of the second message
    gfs.write_bytes(whole[:first] + b"\0\0@" + whole[first + 3 :])
    with refused_with("MODEL-UNREADABLE", f"message 2 has a section at byte {first} that does not"):
        contents_of(gfs)


def test_several_runs_are_refused(tmp_path):
    steps = np.array([3, 6], "timedelta64[h]").astype("timedelta64[ns]")
    coordinates = {"time": TIMES, "step": steps, "level": [850], "latitude": [47.0]}
    coordinates["longitude"] = [7.0]
    dimensions = {"time": 2, "step": 2, "level": 1, "latitude": 1, "longitude": 1}
    path = write(tmp_path / "runs.nc", dimensions, coordinates)
    with refused_with("MODEL-TIME", "2 of time and 2 of step"):
        contents_of(path)


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"CDF\x05" + bytes(64), "MODEL-FORMAT"),
        (b"\x89HDF" + bytes(64), "MODEL-UNREADABLE"),
        (b"CDF\x01" + struct.pack(">I", 7), "MODEL-UNREADABLE"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path, data, code):
    path = tmp_path / "model.nc"
    path.write_bytes(data)
    assert is_model_file(path) == (code != "MODEL-FORMAT")
    with refused(code):
        contents_of(path)


def test_without_the_extra_the_command_that_installs_it_is_named(era5, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with refused("MODEL-PACKAGE", remedy="unbend[nwp]"):
        contents_of(era5)


BOTH = """
from pathlib import Path
import sys
from unbend.tables.weather_files import contents_of
assert contents_of(Path(sys.argv[1]))['format'] == 'GRIB'
import pyproj
to = pyproj.Transformer.from_crs(4326, 25832).transform(47.0, 9.0)
assert round(to[0]) == 500000, to
"""


@pytest.mark.parametrize(
    "order",
    [
        ("geodata.coordinate_systems", "weather_files"),
        ("weather_files", "geodata.coordinate_systems"),
    ],
)
def test_pyproj_and_eccodes_live_together(gfs, order):
    """Loaded after ecCodes pyproj crashes, so each order is tried in a process of its own."""
    script = "".join(f"import unbend.tables.{module}\n" for module in order) + BOTH
    run = subprocess.run([sys.executable, "-c", script, str(gfs)], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


@pytest.mark.shared("nwp")
@pytest.mark.parametrize(
    ("name", "kind", "levels", "members"),
    [
        ("era5_pressure_levels_20180327T13.nc", "pressure", 37, 0),
        ("era5_model_levels_20220829T17.nc", "model", 137, 0),
        ("era5_two_levels_members.grib", "pressure", 2, 10),
    ],
)
def test_real_files(name, kind, levels, members):
    contents = contents_of(SHARED / "nwp" / name)
    assert contents["level_kind"] == kind
    assert len(contents["levels"]) == levels
    assert len(contents["members"]) == members


SOUNDINGS = REPOSITORY / "tests" / "data" / "sounding_files"


def test_inspect_shows_how_a_sounding_is_read(obeyed):
    """Oklahoma, 22 May 2023: 977 hPa at 345 m, by the file's first line."""
    text = one_line(obeyed("inspect", SOUNDINGS / "wyoming_csv_OUN_20230522_12Z.csv"))
    for words in (
        "read as University of Wyoming CSV",
        "2023-05-22 11:04 UTC",
        "35.180°, -97.440°",
        "41 of 41 levels",
        "678 to 977 hPa",
        "dew point from column dew point",
        "atmosphere: {soundings: [{path: wyoming_csv_OUN",
    ):
        assert words in text, words
    reading = json.loads(obeyed("inspect", SOUNDINGS / "igra2_USM00070026_Barrow.txt", "--json"))
    expected = {
        "kind": "sounding",
        "format": "IGRA v2",
        "ascents": 3,
        "station": "USM00070026",
        "levels_in_file": 26,
        "levels": 24,
    }
    assert reading | expected == reading
    arm = obeyed("inspect", SOUNDINGS / "sgpsondewnpnC1.b1.20190101.053200.cdf")
    assert "read as ARM radiosonde netCDF" in arm


def test_inspect_shows_what_a_metar_states(tmp_path, obeyed):
    path = tmp_path / "metar.txt"
    path.write_text(
        "METAR LSZH 141020Z 24008KT CAVOK 18/07 Q1016\n\n"
        "LSZH 141050Z 24008KT 9999 FEW030 M02/M06 Q1015 NOSIG\n",
        encoding="utf-8",
    )
    printed = obeyed("inspect", path)
    lines = [line.split() for line in printed.splitlines()]
    assert lines[0] == ["metar.txt:", "2", "METARs"]
    assert ["LSZH", "day", "14,", "10:20", "UTC", "18.0", "7.0", "1016.5"] in lines
    assert ["LSZH", "day", "14,", "10:50", "UTC", "-2.0", "-6.0", "1015.5"] in lines
    text = one_line(printed)
    assert 'metar: "METAR LSZH 141020Z 24008KT CAVOK 18/07 Q1016"' in text
    reports = json.loads(obeyed("inspect", path, "--json"))["reports"]
    assert [report["temperature_c"] for report in reports] == [18.0, -2.0]
    path.write_text("image,point,x_px\n", "utf-8")
    assert run_command("inspect", path).code == 6  # no log either
