"""What a file of a weather model holds, by files that the tests make and by real ones."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyproj  # noqa: F401  (before ecCodes)
import pytest
import xarray

from tests.conftest import run_command
from unbend.errors import InputError
from unbend.tables.weather_files import contents_of, is_model_file

SHARED = Path(__file__).resolve().parents[3] / "shared" / "nwp"


@pytest.fixture
def era5(tmp_path: Path) -> Path:
    """netCDF-4 with the names of the climate data store since 2024."""
    shape = ("valid_time", "pressure_level", "latitude", "longitude")
    coordinates = {
        "valid_time": np.array(["2026-05-14T10", "2026-05-14T11"], "datetime64[ns]"),
        "pressure_level": ("pressure_level", [1000.0, 850.0, 500.0], {"units": "hPa"}),
        "latitude": [47.0, 46.5],
        "longitude": [6.5, 7.0, 7.5],
        "number": 0,
    }
    t = (shape, np.full((2, 3, 2, 3), 280.0, np.float32), {"units": "K"})
    path = tmp_path / "era5.nc"
    xarray.Dataset({"t": t}, coordinates).to_netcdf(path, engine="h5netcdf")
    return path


@pytest.fixture
def gfs(tmp_path: Path) -> Path:
    """GRIB2, temperature at two levels, from ecCodes' sample."""
    import eccodes

    path = tmp_path / "gfs.grib2"
    with path.open("wb") as file:
        for level in (850, 500):
            message = eccodes.codes_grib_new_from_samples("regular_ll_pl_grib2")
            eccodes.codes_set(message, "level", level)
            eccodes.codes_set(message, "dataDate", 20260514)
            eccodes.codes_write(message, file)
            eccodes.codes_release(message)
    return path


def test_names_of_the_climate_data_store(era5):
    contents = contents_of(era5)
    assert (contents["format"], contents["grid"]) == ("netCDF-4", "latitude-longitude")
    assert contents["levels"] == [500.0, 850.0, 1000.0]
    assert contents["times_utc"] == ["2026-05-14T10:00", "2026-05-14T11:00"]
    assert contents["latitude_deg"] == {"from": 46.5, "to": 47.0, "step": 0.5, "count": 2}
    ended = run_command("inspect", era5)
    assert ended.code == 0
    assert "3 pressure levels, 500 to 1000 hPa" in ended.out
    assert "2026-05-14 10:00 to 2026-05-14 11:00 UTC" in ended.out


def test_grib_and_one_that_was_cut_off(gfs):
    contents = contents_of(gfs)
    assert (contents["format"], contents["levels"]) == ("GRIB", [500.0, 850.0])
    assert contents["times_utc"][0].startswith("2026-05-14")
    assert not list(gfs.parent.glob("*.idx"))
    whole = gfs.read_bytes()
    gfs.write_bytes(whole[:-100])
    with pytest.raises(InputError, match=f"message 2.*the file has {len(whole) - 100} bytes") as no:
        contents_of(gfs)
    assert no.value.code == "MODEL-TRUNCATED"
    assert run_command("inspect", gfs).code == 6
    gfs.write_bytes(whole[:8] + b"\x80" + whole[9:])  # the length of a message: beyond all files
    with pytest.raises(InputError, match="message 1 at byte 0 has 9223372036854"):
        contents_of(gfs)
    at = whole.index(b"GRIB", 4) + 16  # of the first section of the second message: its length
    gfs.write_bytes(whole[:at] + b"\0\0@" + whole[at + 3 :])
    with pytest.raises(InputError, match=f"message 2 has a section at byte {at} that does not"):
        contents_of(gfs)


def test_pascals_and_hectopascals_are_the_same_levels(era5, tmp_path):
    with xarray.open_dataset(era5, engine="h5netcdf") as data:
        level = ("pressure_level", [100_000.0, 85_000.0, 50_000.0], {"units": "Pa"})
        data.assign_coords(pressure_level=level).to_netcdf(tmp_path / "pa.nc", engine="h5netcdf")
    assert contents_of(tmp_path / "pa.nc")["levels"] == [500.0, 850.0, 1000.0]


def test_a_projected_grid_is_named(tmp_path):
    t = (("time", "level", "y", "x"), np.full((1, 3, 2, 2), 280.0))
    at = {"time": np.array(["2026-05-14"], "datetime64[ns]"), "level": [1000, 850, 500]}
    data = xarray.Dataset(
        {"t": t, "crs": ((), 0, {"grid_mapping_name": "lambert_conformal_conic"})}, at
    )
    data.to_netcdf(tmp_path / "hrrr.nc", engine="h5netcdf")
    assert contents_of(tmp_path / "hrrr.nc")["grid"] == "lambert_conformal_conic"


def test_several_runs_are_refused(tmp_path):
    t = (("time", "step", "level", "latitude", "longitude"), np.full((2, 2, 1, 1, 1), 280.0))
    at = {
        "time": np.array(["2026-05-14", "2026-05-15"], "datetime64[ns]"),
        "level": [850],
        "step": np.array([3, 6], "timedelta64[h]").astype("timedelta64[ns]"),
        "latitude": [47.0],
        "longitude": [7.0],
    }
    xarray.Dataset({"t": t}, at).to_netcdf(tmp_path / "runs.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="2 of time and 2 of step") as refused:
        contents_of(tmp_path / "runs.nc")
    assert refused.value.code == "MODEL-TIME"


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
    with pytest.raises(InputError) as refused:
        contents_of(path)
    assert refused.value.code == code


def test_without_the_extra_the_command_that_installs_it_is_named(era5, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError) as refused:
        contents_of(era5)
    assert refused.value.code == "MODEL-PACKAGE"
    assert "unbend[nwp]" in refused.value.remedy


@pytest.mark.parametrize(
    "order",
    [
        ("geodata.coordinate_systems", "weather_files"),
        ("weather_files", "geodata.coordinate_systems"),
    ],
)
def test_pyproj_and_eccodes_live_together(gfs, order):
    """Loaded after ecCodes pyproj crashes, so each order is tried in a process of its own."""
    script = "".join(f"import unbend.tables.{module}\n" for module in order) + (
        "from pathlib import Path\nimport sys\n"
        "from unbend.tables.weather_files import contents_of\n"
        "assert contents_of(Path(sys.argv[1]))['format'] == 'GRIB'\n"
        "import pyproj\n"
        "to = pyproj.Transformer.from_crs(4326, 25832).transform(47.0, 9.0)\n"
        "assert round(to[0]) == 500000, to\n"
    )
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
    contents = contents_of(SHARED / name)
    assert (contents["level_kind"], len(contents["levels"])) == (kind, levels)
    assert len(contents["members"]) == members


SOUNDINGS = Path(__file__).resolve().parents[1] / "data" / "sounding_files"


def test_inspect_shows_how_a_sounding_is_read():
    """Oklahoma, 22 May 2023: 977 hPa at 345 m, by the file's first line."""
    ended = run_command("inspect", SOUNDINGS / "wyoming_csv_OUN_20230522_12Z.csv")
    assert ended.code == 0, ended.text
    text = " ".join(ended.out.split())
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
    ended = run_command("inspect", SOUNDINGS / "igra2_USM00070026_Barrow.txt", "--json")
    reading = json.loads(ended.out)
    assert (reading["kind"], reading["format"], reading["ascents"]) == ("sounding", "IGRA v2", 3)
    assert reading["station"] == "USM00070026"
    assert (reading["levels_in_file"], reading["levels"]) == (26, 24)
    arm = run_command("inspect", SOUNDINGS / "sgpsondewnpnC1.b1.20190101.053200.cdf")
    assert "read as ARM radiosonde netCDF" in arm.out


def test_inspect_shows_what_a_metar_states(tmp_path):
    path = tmp_path / "metar.txt"
    path.write_text(
        "METAR LSZH 141020Z 24008KT CAVOK 18/07 Q1016\n\n"
        "LSZH 141050Z 24008KT 9999 FEW030 M02/M06 Q1015 NOSIG\n",
        encoding="utf-8",
    )
    ended = run_command("inspect", path)
    assert ended.code == 0, ended.text
    lines = [line.split() for line in ended.out.splitlines()]
    assert lines[0] == ["metar.txt:", "2", "METARs"]
    assert ["LSZH", "day", "14,", "10:20", "UTC", "18.0", "7.0", "1016.5"] in lines
    assert ["LSZH", "day", "14,", "10:50", "UTC", "-2.0", "-6.0", "1015.5"] in lines
    text = " ".join(ended.out.split())
    assert 'metar: "METAR LSZH 141020Z 24008KT CAVOK 18/07 Q1016"' in text
    reports = json.loads(run_command("inspect", path, "--json").out)["reports"]
    assert [report["temperature_c"] for report in reports] == [18.0, -2.0]
    path.write_text("image,point,x_px\n", encoding="utf-8")
    assert run_command("inspect", path).code == 6  # no log either
