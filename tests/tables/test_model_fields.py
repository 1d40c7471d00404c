"""Fields of a weather model read from netCDF and GRIB: the same air by all names, and refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray
from scipy.integrate import cumulative_trapezoid
from scipy.io import netcdf_file

from tests.model_files import dataset, grib, netcdf, on_model_levels
from unbend.atmosphere.soundings.model_column import model_column
from unbend.errors import InputError
from unbend.geodesy import normal_gravity
from unbend.messages import Ledger
from unbend.simulate.true_air import temperature_k, true_air, vapour_pressure_pa
from unbend.tables.model_fields import FlightArea, read_model_field
from unbend.tables.weather_files import open_datasets

SHARED = Path(__file__).resolve().parents[3] / "shared" / "nwp"
PLACE = (np.radians(47.3), np.radians(8.6))
H = np.arange(-200.0, 20_000.0, 20.0)
PRESSURE = true_air(PLACE[0]).pressure_pa(H)


def ns(when: str) -> int:
    return int(np.datetime64(when, "ns").astype(np.int64))


NOON = ns("2026-05-14T10:30")


def area(place=PLACE, time_ns=NOON) -> FlightArea:
    return FlightArea(*(np.array([a]) for a in place), np.array([time_ns]))


def air(latitude, longitude, when):
    """It warms by 2 K an hour and by 1 K a degree to the east; other fields stay."""
    warmer = 2.0 * (when - np.datetime64("2026-05-14T10")) / np.timedelta64(1, "h")
    warmer += np.degrees(longitude) % 360.0 - 8.0
    return H, temperature_k(H) + warmer, PRESSURE, np.maximum(vapour_pressure_pa(H), 1e-3)


@pytest.fixture(scope="module")
def fields() -> xarray.Dataset:
    return dataset(air, (48.0, 47.0), (8.0, 8.5, 9.0), ("2026-05-14T10", "2026-05-14T11"))


def read(path, place=PLACE, time_ns=NOON, ledger=None, **how):
    return read_model_field(
        path, area(place, time_ns), Ledger() if ledger is None else ledger, **how
    )


def column(field, place=PLACE, time_ns=NOON, ground_h_m=450.0):
    return model_column(field, (*place, time_ns), ground_h_m=ground_h_m, highest_h_m=4000.0)


def test_a_dimension_that_is_not_known_is_named(fields, tmp_path):
    twice = fields.assign(t=xarray.concat([fields["t"], fields["t"]], dim="percentile"))
    with pytest.raises(InputError, match=r"percentile \(2\)") as refused:
        read(netcdf(tmp_path / "percentiles.nc", twice))
    assert refused.value.code == "MODEL-VARIABLE"


def test_a_bug_is_no_damaged_file(fields, tmp_path):
    with (
        pytest.raises(ZeroDivisionError),
        open_datasets(netcdf(tmp_path / "era5.nc", fields)) as (datasets, _),
    ):
        assert 1 / (len(datasets) - 1)


COLUMN = ("h_m", "temperature_k", "pressure_pa", "vapour_pressure_pa")


def on_levels(found) -> np.ndarray:
    """Levels of the file, without those that continue a column down to the ground."""
    return np.isclose(found.pressure_pa % 2500.0, 0.0) | np.isclose(found.pressure_pa % 2500, 2500)


def test_a_column_is_between_its_nodes_in_place_and_time(fields, tmp_path):
    read_column, _ = column(read(netcdf(tmp_path / "era5.nc", fields)))
    # Half past ten, 0.6 degrees east of 8: 1 K and 0.6 K warmer.
    on = on_levels(read_column)
    h, t, p, e = (getattr(read_column, name)[on] for name in COLUMN)
    np.testing.assert_allclose(t, temperature_k(h) + 1.6, atol=0.02)
    np.testing.assert_allclose(e, vapour_pressure_pa(h), rtol=2e-3)
    np.testing.assert_allclose(p, true_air(PLACE[0]).pressure_pa(h), rtol=2e-4)
    assert read_column.h_m[0] == pytest.approx(450.0)
    assert read_column.h_m[-1] < 10_500.0
    assert read_column.name == "weather model era5.nc 2026-05-14T10:00"


def relative(fields):
    e = fields.q * fields.pressure_level * 100.0 / (0.622 + 0.378 * fields.q)
    t = fields.t
    saturated = np.exp(
        -6096.9385 / t + 21.2409642 - 2.711193e-2 * t + 1.673952e-5 * t**2 + 2.433502 * np.log(t)
    )
    return fields.drop_vars("q").assign(r=(100.0 * e / saturated).assign_attrs(units="%"))


def two_versions(fields):
    """ERA5 and its preliminary months: each time in one of them only."""
    first = fields.where(fields.valid_time == fields.valid_time[0])
    last = fields.where(fields.valid_time == fields.valid_time[1])
    return xarray.concat([first, last], "expver", join="outer").assign_coords(expver=[1, 5])


SAME_AIR = {
    "upside down": lambda f: f.isel(
        latitude=slice(None, None, -1), pressure_level=slice(None, None, -1)
    ),
    "old names": lambda f: f.rename(valid_time="time", pressure_level="level"),
    "time dimension last": lambda f: f.transpose(..., "valid_time"),
    "geopotential metres": lambda f: f.assign(z=(f.z / 9.80665).assign_attrs(units="m")),
    "relative humidity": relative,
    "levels in pascals": lambda f: f.assign_coords(
        pressure_level=("pressure_level", 100.0 * f.pressure_level.values, {"units": "Pa"})
    ),
    "without units": lambda f: f.assign_coords(pressure_level=f.pressure_level.values),
    "two versions": two_versions,
    "the control of an ensemble": lambda f: xarray.concat([f, f + 9.0], "number").assign_coords(
        number=[0, 1]
    ),
}


@pytest.mark.parametrize("what", SAME_AIR)
def test_one_air_by_all_names(fields, tmp_path, what):
    usual, _ = column(read(netcdf(tmp_path / "usual.nc", fields)))
    with xarray.set_options(keep_attrs=True):
        other = SAME_AIR[what](fields)
    member = 0 if "ensemble" in what else None
    ledger = Ledger()
    found, _ = column(read(netcdf(tmp_path / "other.nc", other), member=member, ledger=ledger))
    assert not list(ledger)
    low = usual.h_m < 7000.0  # saturation far below freezing is extrapolated differently
    for name in COLUMN:
        rtol = 8e-3 if what == "relative humidity" else 1e-9
        np.testing.assert_allclose(getattr(found, name)[low], getattr(usual, name)[low], rtol=rtol)


def test_grib_has_the_air_of_netcdf_and_a_forecast_its_lead_time(fields, tmp_path):
    usual, _ = column(read(netcdf(tmp_path / "usual.nc", fields)))
    found, _ = column(read(grib(tmp_path / "gfs.grib2", fields, lead_h=24)))
    np.testing.assert_allclose(found.temperature_k, usual.temperature_k, rtol=1e-6)
    np.testing.assert_allclose(found.h_m, usual.h_m, atol=0.05)
    np.testing.assert_allclose(
        found.errors.temperature_k, np.hypot(usual.errors.temperature_k, 0.5)
    )
    assert found.errors.log_pressure > usual.errors.log_pressure


def test_model_levels_in_grib_give_the_same_air(tmp_path):
    nodes = ((48.0, 47.0), (8.0, 8.5, 9.0), ("2026-05-14T10", "2026-05-14T11"), 400.0)

    def still(*_):
        return H, temperature_k(H), PRESSURE, np.maximum(vapour_pressure_pa(H), 1e-3)

    field = read(grib(tmp_path / "levels.grib2", on_model_levels(still, *nodes)))
    assert field.on_model_levels
    found, notes = column(field)
    assert [n.code for n in notes] == ["MODEL-UNDERGROUND"]
    h = found.h_m[1:]
    assert h.size > 35
    np.testing.assert_allclose(found.temperature_k[1:], temperature_k(h), atol=0.02)
    np.testing.assert_allclose(found.pressure_pa[1:], true_air(PLACE[0]).pressure_pa(h), rtol=2e-4)
    np.testing.assert_allclose(found.vapour_pressure_pa[1:], vapour_pressure_pa(h), rtol=5e-3)


def with_wrong_level(fields, dimension, level, kelvin):
    return fields.assign(t=fields.t + kelvin * (fields[dimension] == level))


MODEL_LEVELS_REFUSED = {
    "91 levels": (
        lambda f: f.assign_coords(hybrid=f.hybrid - 46.0),
        "MODEL-LEVELS",
        "are 14 to 91, 78 in total: the lowest level of ERA5 is 137",
    ),
    "one is missing": (
        lambda f: f.drop_sel(hybrid=100.0),
        "MODEL-LEVELS",
        "60 to 137, 77 in total",
    ),
    "no lnsp": (lambda f: f.drop_vars("lnsp"), "MODEL-VARIABLE", "no lnsp"),
    "surface pressure in the place of its logarithm": (
        lambda f: f.assign(lnsp=np.exp(f.lnsp)),
        "MODEL-UNITS",
        "z or lnsp has another unit",
    ),
    "heights of the ground divided twice": (
        lambda f: f.assign(z=f.z * 9.80665),
        "MODEL-UNITS",
        "z or lnsp has another unit",
    ),
    "one warm level": (
        lambda f: with_wrong_level(f, "hybrid", 120.0, 30.0),
        "MODEL-LEVELS",
        r"K on level 120 to 2\d\d\.\d K on level 119",
    ),
    "one cold level at the ground": (
        lambda f: with_wrong_level(f, "hybrid", 137.0, -30.0),
        "MODEL-LEVELS",
        r"K on level 137 to 2\d\d\.\d K on level 136",
    ),
}


@pytest.mark.parametrize("what", MODEL_LEVELS_REFUSED)
def test_model_levels_that_make_no_column_are_refused(tmp_path, what):
    change, code, words = MODEL_LEVELS_REFUSED[what]
    whole = on_model_levels(air, (48.0, 47.0), (8.0, 9.0), ("2026-05-14T10",), 400.0)
    with pytest.raises(InputError, match=words) as refused:
        read(netcdf(tmp_path / "levels.nc", change(whole)))
    assert refused.value.code == code


@pytest.mark.parametrize("ground_m", [150.0, 400.0, 900.0, 2000.0])
def test_a_ground_in_metres_without_a_unit_is_found_by_pressure_or_the_missions(tmp_path, ground_m):
    """As geopotential it would lie at a tenth, and all levels with it."""

    def still(*_):
        return H, temperature_k(H), PRESSURE, np.maximum(vapour_pressure_pa(H), 1e-3)

    nodes = ((48.0, 47.0), (8.0, 8.5, 9.0), ("2026-05-14T10", "2026-05-14T11"), ground_m)
    right = on_model_levels(still, *nodes)
    ledger = Ledger()
    usual, _ = column(
        read(netcdf(tmp_path / "right.nc", right), ledger=ledger), ground_h_m=ground_m
    )
    assert not list(ledger)
    metres = netcdf(tmp_path / "metres.nc", right.assign(z=right.z / 9.80665))
    field = read(metres, ledger=ledger)
    if ground_m < 500.0:
        with pytest.raises(InputError, match=f"in metres at {ground_m:.0f} m") as refused:
            column(field, ground_h_m=ground_m)
        assert refused.value.code == "MODEL-UNITS"
        return
    found, _ = column(field, ground_h_m=ground_m)
    np.testing.assert_allclose(found.h_m, usual.h_m, atol=0.1)
    assert [(e.code, e.count) for e in ledger] == [("MODEL-GROUND-UNIT", 12)]


def test_gfs_has_relative_humidity_and_geopotential_metres(fields, tmp_path):
    """Around Greenwich, longitudes from 0 to 360 in a file that goes round the earth."""
    around = np.arange(0.0, 360.0, 90.0).tolist()
    place = (PLACE[0], np.radians(-45.0))
    when = NOON

    def still(*_):
        return H, temperature_k(H), PRESSURE, np.maximum(vapour_pressure_pa(H), 1e-3)

    gfs = relative(dataset(still, (48.0, 47.0), around, ("2026-05-14T09", "2026-05-14T12")))
    gfs = gfs.assign(gh=gfs.z / 9.80665).drop_vars("z")
    found, _ = column(read(grib(tmp_path / "gfs.grib2", gfs, lead_h=3), place, when), place)
    on = on_levels(found)
    h = found.h_m[on]
    np.testing.assert_allclose(found.temperature_k[on], temperature_k(h), atol=0.02)
    low = h < 7000.0
    np.testing.assert_allclose(
        found.vapour_pressure_pa[on][low], vapour_pressure_pa(h[low]), rtol=1e-2
    )


@pytest.mark.parametrize("east", [(178.5, 179.5, 180.5), (-181.5, -180.5, -179.5)])
@pytest.mark.parametrize("at", [179.9, -180.1])
def test_across_the_date_line(fields, tmp_path, east, at):
    over = fields.assign_coords(longitude=[(d + 180.0) % 360.0 - 180.0 for d in east])
    place = (PLACE[0], np.radians(at))
    found, _ = column(read(netcdf(tmp_path / "line.nc", over.sortby("longitude")), place), place)
    # The nodes keep their columns: 1 K a degree eastwards, half a degree from node to node.
    share = 0.5 * (179.9 - 178.5)
    on = on_levels(found)
    expected = temperature_k(found.h_m[on]) + 1.0 + share
    np.testing.assert_allclose(found.temperature_k[on], expected, atol=0.02)


def test_pressures_in_the_wrong_unit_are_repaired_and_reported(fields, tmp_path):
    level = ("pressure_level", fields.pressure_level.values, {"units": "Pa"})
    ledger = Ledger()
    found = read(
        netcdf(tmp_path / "pa.nc", fields.assign_coords(pressure_level=level)), ledger=ledger
    )
    assert found.level[-1] == 100_000.0
    assert [(e.code, "1000 Pa" in e.what) for e in ledger] == [("MODEL-PRESSURE-UNIT", True)]


def spoiled(fields, name, change):
    return fields.assign({name: change(fields[name]).assign_attrs(fields[name].attrs)})


REFUSED = {
    "no humidity": (lambda f: f.drop_vars("q"), "MODEL-VARIABLE", "no specific or relative humid"),
    "no geopotential": (lambda f: f.drop_vars("z"), "MODEL-VARIABLE", "no geopotential on levels"),
    "three levels": (
        lambda f: f.isel(pressure_level=[0, 5, 9]),
        "MODEL-LEVELS",
        r"3 levels in all \(775, 875, 1000 hPa\)",
    ),
    "a member to choose": (
        lambda f: xarray.concat([f, f], "number").assign_coords(number=[0, 1]),
        "MODEL-MEMBER",
        "members 0 to 1, and none is chosen",
    ),
    "projected": (
        lambda f: (
            f.rename(latitude="y", longitude="x")
            .drop_vars(["x", "y"])
            .assign(crs=((), 0, {"grid_mapping_name": "lambert_conformal_conic"}))
        ),
        "MODEL-GRID",
        "lambert_conformal_conic",
    ),
    "rotated": (
        lambda f: f.assign(pole=((), 0, {"grid_mapping_name": "rotated_latitude_longitude"})),
        "MODEL-GRID",
        "its grid is rotated_latitude_longitude",
    ),
    "Celsius": (lambda f: spoiled(f, "t", lambda t: t - 273.15), "MODEL-UNITS", "temperatures"),
    "g/kg": (lambda f: spoiled(f, "q", lambda q: 1000.0 * q), "MODEL-UNITS", "8.79.*: neither kg"),
    "humidity missing as -9999": (
        lambda f: spoiled(f, "q", lambda q: q.where(q.pressure_level != 700.0, -9999.0)),
        "MODEL-UNITS",
        "humidity from -9999 up to",
    ),
    "a mixing ratio called r": (lambda f: f.rename(q="r"), "MODEL-UNITS", "relative humidity from"),
    "hybrid levels that look like pressures": (
        lambda f: f.assign_coords(
            lev=(
                "pressure_level",
                f.pressure_level.values,
                {"units": "hPa", "long_name": "hybrid level"},
            )
        ).swap_dims(pressure_level="lev"),
        "MODEL-VARIABLE",
        "no lnsp",
    ),
    "feet": (lambda f: spoiled(f, "z", lambda z: z / 0.3048), "MODEL-UNITS", "as thick"),
    "levels of the stratosphere": (
        lambda f: f.assign_coords(pressure_level=f.pressure_level / 7.0),
        "MODEL-UNITS",
        "not near the ground",
    ),
    "humidity of other times": (
        lambda f: xarray.merge([f.drop_vars("q"), f[["q"]].isel(valid_time=0, drop=True)]),
        "MODEL-VARIABLE",
        "time",
    ),
    "humidity of another day": (
        lambda f: xarray.merge(
            [
                f.drop_vars("q").isel(valid_time=[0]),
                f[["q"]]
                .isel(
                    valid_time=[0],
                )
                .rename(valid_time="time")
                .assign_coords(time=np.array(["2017-01-01"], "M8[ns]")),
            ]
        ),
        "MODEL-VARIABLE",
        "time",
    ),
    "a ground in meters that would be geopotential": (
        lambda f: f.assign(orog=(f.z[0, 0] * 0.0 + 12_000.0).assign_attrs(units="meters")),
        "MODEL-UNITS",
        "ground",
    ),
    "a high ground": (
        lambda f: f.assign(orog=(f.z[0, 0] * 0.0 + 12_000.0).assign_attrs(units="m")),
        "MODEL-UNITS",
        "ground",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_such_field_is_refused_with_its_numbers(fields, tmp_path, what):
    change, code, words = REFUSED[what]
    with pytest.raises(InputError, match=words) as refused:
        read(netcdf(tmp_path / "bad.nc", change(fields)))
    assert refused.value.code == code


def test_a_projected_grib_such_as_hrrr_is_refused_by_name(tmp_path):
    import eccodes

    path = tmp_path / "hrrr.grib2"
    with path.open("wb") as file:
        for level in (1000, 850, 700, 500, 300):
            message = eccodes.codes_grib_new_from_samples("regular_ll_pl_grib2")
            for key, value in {
                "gridType": "lambert",
                "Nx": 3,
                "Ny": 2,
                "DxInMetres": 3000,
                "DyInMetres": 3000,
                "latitudeOfFirstGridPointInDegrees": 40.0,
                "shortName": "t",
                "level": level,
                "longitudeOfFirstGridPointInDegrees": 260.0,
                "LoVInDegrees": 262.5,
                "LaDInDegrees": 38.5,
                "Latin1InDegrees": 38.5,
                "Latin2InDegrees": 38.5,
            }.items():
                eccodes.codes_set(message, key, value)
            eccodes.codes_set_values(message, np.full(6, 280.0))
            eccodes.codes_write(message, file)
            eccodes.codes_release(message)
    with pytest.raises(InputError, match="its grid is lambert") as refused:
        read(path)
    assert refused.value.code == "MODEL-GRID"


def test_the_lead_time_of_a_forecast_is_found_as_each_program_writes_it(fields, tmp_path):
    run = np.datetime64("2026-05-12T10:30", "ns")
    stamped = {
        "forecast_reference_time": fields.assign_coords(forecast_reference_time=run),
        "reftime": fields.assign_coords(reftime=run),
    }
    for name, changed in stamped.items():
        found = read(netcdf(tmp_path / f"{name}.nc", changed))
        assert found.lead_h.tolist() == [47.5, 48.5], name
    by_step = fields.isel(valid_time=[0]).rename(valid_time="time")
    by_step = by_step.assign_coords(time=[run], step=np.timedelta64(48, "h").astype("m8[ns]"))
    found = read(netcdf(tmp_path / "step.nc", by_step))
    assert (found.time_ns.tolist(), found.lead_h.tolist()) == ([NOON], [48.0])


def test_hours_between_the_times_of_a_file_are_too_far_from_both(fields, tmp_path):
    apart = fields.assign_coords(
        valid_time=np.array(["2026-05-13T10:30", "2026-05-15T10:30"], "M8[ns]")
    )
    path = netcdf(tmp_path / "apart.nc", apart)
    times = np.array([NOON - 86_400 * 10**9, NOON, NOON + 86_400 * 10**9])
    places = (np.full(3, angle) for angle in PLACE)
    with pytest.raises(InputError, match=r"24\.0 h away") as refused:
        read_model_field(path, FlightArea(*places, times), Ledger())
    assert refused.value.code == "MODEL-TIME"


def test_another_member_than_the_file_has_is_refused(fields, tmp_path):
    path = netcdf(tmp_path / "one.nc", fields.assign_coords(number=3))
    assert read(path, member=3).time_ns.size == 2
    for bad, member in ((path, 4), (netcdf(tmp_path / "none.nc", fields), 0)):
        with pytest.raises(InputError, match="members") as refused:
            read(bad, member=member)
        assert refused.value.code == "MODEL-MEMBER"


@pytest.mark.parametrize(
    ("place", "when", "code", "words"),
    [
        ((47.3, 8.6), "2026-05-14T18:30", "MODEL-TIME", "7.5 h away"),
        ((47.3, 8.6), "2025-05-14T10:30", "MODEL-TIME", "8759.5 h away"),
        ((49.0, 8.6), "2026-05-14T10:30", "MODEL-AREA", "111 km from its nodes"),
        ((47.3, 12.0), "2026-05-14T10:30", "MODEL-AREA", "226 km from its nodes"),
        ((47.3, -171.5), "2026-05-14T10:30", "MODEL-AREA", "km from its nodes"),
    ],
)
def test_another_place_or_time_is_refused_with_the_distance(
    fields, tmp_path, place, when, code, words
):
    path = netcdf(tmp_path / "era5.nc", fields)
    at = np.radians(place)
    with pytest.raises(InputError, match=words) as refused:
        read(path, at, ns(when)).refuse_outside(at[:1], at[1:])
    assert refused.value.code == code


def test_a_hole_in_the_grid_is_no_place_to_interpolate_over(fields, tmp_path):
    wide = xarray.concat([fields, fields.assign_coords(longitude=[11.0, 11.5, 12.0])], "longitude")
    at = np.array([PLACE[0]]), np.radians([10.0])
    field = read(netcdf(tmp_path / "hole.nc", wide), (at[0][0], at[1][0]))
    with pytest.raises(InputError, match="75 km") as refused:
        field.refuse_outside(*at)
    assert refused.value.code == "MODEL-AREA"


def test_levels_with_missing_values_and_under_the_ground_are_left_out_and_counted(fields, tmp_path):
    holes = fields.copy(deep=True)
    holes.t[:, 8, 0, 1] = np.nan
    found, notes = column(read(netcdf(tmp_path / "holes.nc", holes)), ground_h_m=1000.0)
    assert {n.code: n.count for n in notes} == {"MODEL-MISSING": 1, "MODEL-UNDERGROUND": 4}
    assert not np.isclose(found.pressure_pa, 80_000.0).any()
    lost = fields.copy(deep=True)  # all from 700 hPa up: what is missing is the column's top
    lost.z[:, 12:] = np.nan
    found, notes = column(read(netcdf(tmp_path / "lost.nc", lost)), ground_h_m=1000.0)
    assert {n.code: n.count for n in notes}["MODEL-MISSING"] == fields.pressure_level.size - 12
    assert found.h_m[-1] < 4000.0
    holes.t[:, 4:, 0, 1] = np.nan
    with pytest.raises(InputError, match="0 levels above the ground"):
        column(read(netcdf(tmp_path / "more.nc", holes)), ground_h_m=1000.0)


@pytest.mark.parametrize("kelvin", [30.0, -30.0])
@pytest.mark.parametrize("hpa", [950, 850, 700, 500, 350])
def test_a_single_wrong_level_is_refused_with_its_number(fields, tmp_path, hpa, kelvin):
    wrong = with_wrong_level(fields, "pressure_level", hpa, kelvin)
    with pytest.raises(InputError, match=f"K on {hpa} hPa.*this does not occur in air") as refused:
        read(netcdf(tmp_path / "wrong.nc", wrong))
    assert refused.value.code == "MODEL-LEVELS"


def test_a_layer_that_is_not_as_thick_as_its_air_is_told_of(fields, tmp_path):
    """A cold lowest level could be an inversion; its height says that it is none."""
    cold = with_wrong_level(fields, "pressure_level", 1000.0, -28.0)
    found, (told,) = column(read(netcdf(tmp_path / "cold.nc", cold)), ground_h_m=50.0)
    assert told.code == "MODEL-LAYER"
    assert "between 1000 and 975 hPa" in told.what
    assert found.pressure_pa[0] > 99_000.0


def test_below_the_lowest_level_sigma_grows(fields, tmp_path):
    field = read(netcdf(tmp_path / "high.nc", fields.isel(pressure_level=slice(9, None))))
    found, (extended,) = column(field, ground_h_m=450.0)
    assert extended.code == "MODEL-EXTENDED"
    assert found.h_m[0] == pytest.approx(450.0)
    depth = np.interp(77_500.0, PRESSURE[::-1], H[::-1]) - 450.0
    assert found.errors.temperature_k[0] == pytest.approx(np.hypot(1.0, 8e-3 * depth), rel=0.02)
    assert (np.diff(found.errors.temperature_k) <= 0.0).all()
    # 6.5 K/km, hydrostatic: the air is about 6.9 K/km with an inversion, so p is near.
    assert found.pressure_pa[0] == pytest.approx(true_air(PLACE[0]).pressure_pa(450.0), rel=5e-3)
    assert found.errors.log_pressure > 2e-3


def test_a_ground_that_nobody_knows_is_the_models(fields, tmp_path):
    flat = fields.z[:, 0] * 0.0
    for more, height in ({}, 0.0), ({"orog": flat + 600.0}, 600.0), ({"orog": flat / 0.0}, 0.0):
        with_ground = fields.assign({k: v.assign_attrs(units="m") for k, v in more.items()})
        _, notes = column(
            read(netcdf(tmp_path / f"g{height}.nc", with_ground)), ground_h_m=float("nan")
        )
        (entry,) = [n for n in notes if n.code == "MODEL-GROUND"]
        assert ("600 m" in entry.what) == bool(height)


@pytest.mark.shared("nwp")
def test_era5_at_a_node_to_the_last_digit():
    path = SHARED / "era5_pressure_levels_20180327T13.nc"
    with netcdf_file(path, mmap=False) as file:
        raw = {
            name: v.data * getattr(v, "scale_factor", 1.0) + getattr(v, "add_offset", 0.0)
            for name, v in file.variables.items()
        }
    j = 9
    k = 30
    place = (np.radians(raw["latitude"][j]), np.radians(raw["longitude"][k]))
    when = ns("2018-03-27T13:00")
    found, _ = column(read(path, place, when), place, when, ground_h_m=0.0)
    p = 100.0 * raw["level"][::-1]
    q = raw["q"][0, ::-1, j, k]
    on = on_levels(found)
    rows = [int(np.argmin(np.abs(p - level))) for level in found.pressure_pa[on]]
    e = p * q / (0.622 + 0.378 * q)
    height = normal_gravity(place[0]).height(raw["z"][0, ::-1, j, k] / 9.80665)
    truth = (height, raw["t"][0, ::-1, j, k], p, e)
    assert on.sum() > 15
    for name, values in zip(COLUMN, truth, strict=True):
        np.testing.assert_allclose(getattr(found, name)[on], values[rows], rtol=1e-6)


@pytest.mark.shared("nwp")
@pytest.mark.parametrize(
    ("name", "when", "place", "ground"),
    [
        ("era5_model_levels_20220829T17.nc", "2022-08-29T17:00", (70.25, -156.5), np.nan),
        ("era5_pressure_levels_20180327T13.nc", "2018-03-27T13:00", (20.0, -95.0), 0.0),
        ("era5_pressure_levels_20180327T13.nc", "2018-03-27T13:00", (21.0, -103.0), 1500.0),
    ],
)
def test_pressure_between_real_levels_is_that_of_an_ode_from_the_nearer_level(
    name, when, place, ground
):
    """Integrated here, T_M linear in height; linear in ln p differs by 1e-6.

    From level to level it misses by 3e-6 on model levels and up to 1.7e-4 on pressure levels, whose
    file rounds heights to 0.73 m (8.8e-5 of p) and has 37 of 137 levels: half of that between them.
    """
    at = tuple(np.radians(place))
    time_ns = ns(when)
    found, _ = column(read(SHARED / name, at, time_ns), at, time_ns, ground_h_m=ground)
    h, t, p, e = (getattr(found, quantity) for quantity in COLUMN)
    height = normal_gravity(at[0]).geopotential_height(h)
    virtual = t / (1.0 - 0.378 * e / p)
    fine = np.linspace(height[0], height[-1], 100_001)
    fall = 9.80665 * 28.9644 / 8314.32 / np.interp(fine, height, virtual)
    log_p = np.log(p[0]) - cumulative_trapezoid(fall, fine, initial=0.0)
    apart = np.diff(np.interp(height, fine, log_p) - np.log(p))
    assert 0.5 * np.abs(apart).max() < 1e-4
    assert np.median(np.abs(apart)) < 1e-4


@pytest.mark.shared("nwp")
def test_a_real_file_with_too_few_levels_says_which():
    with pytest.raises(InputError, match=r"2 levels in all \(500, 850 hPa\)"):
        read(SHARED / "era5_two_levels_members.grib", time_ns=ns("2017-01-01T12"))
