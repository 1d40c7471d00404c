"""Fields of a weather model read from netCDF and GRIB: the same air by all names, and refusals."""

from pathlib import Path

import numpy as np
import pytest
import xarray
from numpy.testing import assert_allclose
from scipy.integrate import cumulative_trapezoid
from scipy.io import netcdf_file

from tests.helpers import ns, with_code
from tests.logs import SHARED
from tests.model_files import PRESSURE_LEVELS, dataset, grib, netcdf, on_model_levels
from tests.tables.checks import assert_within, refused_with
from tests.tables.grib_messages import write_grib
from unbend.atmosphere.soundings.model_column import model_column
from unbend.geodesy import normal_gravity
from unbend.messages import Ledger
from unbend.simulate.true_air import temperature_k, true_air, vapour_pressure_pa
from unbend.tables.model_fields import FlightArea, read_model_field
from unbend.tables.weather_files import open_datasets

MODELS = SHARED / "nwp"
PLACE = (np.radians(47.3), np.radians(8.6))
NORTH = (48.0, 47.0)
EAST = (8.0, 8.5, 9.0)
TIMES = ("2026-05-14T10", "2026-05-14T11")
H = np.arange(-200.0, 20_000.0, 20.0)
TRUE_AIR = true_air(PLACE[0])
PRESSURE = TRUE_AIR.pressure_pa(H)
COLUMN = ("h_m", "temperature_k", "pressure_pa", "vapour_pressure_pa")


NOON = ns("2026-05-14T10:30")


def still_air(*_):
    vapour_pa = np.maximum(vapour_pressure_pa(H), 1e-3)
    return H, temperature_k(H), PRESSURE, vapour_pa


def air(latitude, longitude, when):
    """It warms by 2 K an hour and by 1 K a degree to the east; other fields stay."""
    hours = (when - np.datetime64(TIMES[0])) / np.timedelta64(1, "h")
    degrees_east = np.degrees(longitude) % 360.0 - 8.0
    h, t, p, e = still_air()
    return h, t + 2.0 * hours + degrees_east, p, e


@pytest.fixture(scope="module")
def fields():
    return dataset(air, NORTH, EAST, TIMES)


def read(path, place=PLACE, time_ns=NOON, ledger=None, **how):
    latitude, longitude = np.reshape(place, (2, 1))
    area = FlightArea(latitude, longitude, np.array([time_ns]))
    if ledger is None:
        ledger = Ledger()
    return read_model_field(path, area, ledger, **how)


def column(field, place=PLACE, time_ns=NOON, ground_h_m=450.0):
    return model_column(
        field,
        (*place, time_ns),
        ground_h_m=ground_h_m,
        highest_h_m=4000.0,
    )


def as_netcdf(fields):
    return netcdf(Path("era5.nc").absolute(), fields)


def as_grib(fields, lead_h=0):
    return grib(Path("gfs.grib2").absolute(), fields, lead_h)


def column_of(fields, place=PLACE, ground_h_m=450.0, **how):
    """The column of fields that are written as netCDF, and what is said of it."""
    field = read(as_netcdf(fields), place, **how)
    return column(field, place, ground_h_m=ground_h_m)


def test_a_dimension_that_is_not_known_is_named(fields):
    temperatures = xarray.concat([fields.t, fields.t], dim="percentile")
    twice = fields.assign(t=temperatures)
    with refused_with("MODEL-VARIABLE", r"percentile \(2\)"):
        read(as_netcdf(twice))


def test_a_bug_is_no_damaged_file(fields):
    path = as_netcdf(fields)
    with pytest.raises(ZeroDivisionError), open_datasets(path) as (datasets, _):
        assert 1 / (len(datasets) - 1)


def on_levels(column):
    """Levels of the file, without those that continue a column down to the ground."""
    steps = column.pressure_pa / 2500.0
    return np.isclose(steps, np.round(steps))


def test_a_column_is_between_its_nodes_in_place_and_time(fields):
    read_column, _ = column_of(fields)
    # Half past ten, 0.6 degrees east of 8: 1 K and 0.6 K warmer.
    rows = on_levels(read_column)
    h = read_column.h_m[rows]
    assert_within(read_column.temperature_k[rows], temperature_k(h) + 1.6, 0.02)
    assert_allclose(read_column.vapour_pressure_pa[rows], vapour_pressure_pa(h), rtol=2e-3)
    assert_allclose(read_column.pressure_pa[rows], TRUE_AIR.pressure_pa(h), rtol=2e-4)
    assert read_column.h_m[0] == pytest.approx(450.0)
    assert read_column.h_m[-1] < 10_500.0
    assert read_column.name == "weather model era5.nc 2026-05-14T10:00"


def relative(fields):
    """Relative humidity [%] in the place of the specific one; saturation by Sonntag (1990)."""
    e = fields.q * fields.pressure_level * 100.0 / (0.622 + 0.378 * fields.q)
    t = fields.t
    saturated = np.exp(
        -6096.9385 / t + 21.2409642 - 2.711193e-2 * t + 1.673952e-5 * t**2 + 2.433502 * np.log(t)
    )
    percent = 100.0 * e / saturated
    return fields.drop_vars("q").assign(r=percent.assign_attrs(units="%"))


def two_versions(fields):
    """ERA5 and its preliminary months: each time in one of them only."""
    first = fields.where(fields.valid_time == fields.valid_time[0])
    last = fields.where(fields.valid_time == fields.valid_time[1])
    both = xarray.concat([first, last], "expver", join="outer")
    return both.assign_coords(expver=[1, 5])


def upside_down(fields):
    backward = slice(None, None, -1)
    return fields.isel(latitude=backward, pressure_level=backward)


def with_levels(fields, levels, **attributes):
    return fields.assign_coords(pressure_level=("pressure_level", levels, attributes))


def in_metres(fields, **attributes):
    z = fields.z / 9.80665
    return fields.assign(z=z.assign_attrs(attributes))


def two_members(fields, other):
    members = xarray.concat([fields, other], "number")
    return members.assign_coords(number=[0, 1])


SAME_AIR = {
    "upside down": upside_down,
    "old names": lambda f: f.rename(valid_time="time", pressure_level="level"),
    "time dimension last": lambda f: f.transpose(..., "valid_time"),
    "geopotential metres": lambda f: in_metres(f, units="m"),
    "relative humidity": relative,
    "levels in pascals": lambda f: with_levels(
        f,
        100.0 * f.pressure_level.values,
        units="Pa",
    ),
    "without units": lambda f: with_levels(f, f.pressure_level.values),
    "two versions": two_versions,
    "the control of an ensemble": lambda f: two_members(f, f + 9.0),
}


@pytest.mark.parametrize("case", SAME_AIR)
def test_one_air_by_all_names(fields, case):
    usual, _ = column_of(fields)
    with xarray.set_options(keep_attrs=True):
        changed = SAME_AIR[case](fields)
    member = 0 if "ensemble" in case else None
    ledger = Ledger()

    same, _ = column_of(changed, member=member, ledger=ledger)

    assert not list(ledger)
    low = usual.h_m < 7000.0  # saturation far below freezing is extrapolated differently
    rtol = 8e-3 if case == "relative humidity" else 1e-9
    for name in COLUMN:
        values = getattr(same, name)[low]
        assert_allclose(values, getattr(usual, name)[low], rtol=rtol)


def test_grib_has_the_air_of_netcdf_and_a_forecast_its_lead_time(fields):
    coarse = fields.isel(pressure_level=slice(None, None, 3))
    usual, _ = column_of(coarse)
    path = as_grib(coarse, lead_h=24)

    forecast, _ = column(read(path))

    assert_allclose(forecast.temperature_k, usual.temperature_k, rtol=1e-6)
    assert_within(forecast.h_m, usual.h_m, 0.05)
    sigma = np.hypot(usual.errors.temperature_k, 0.5)
    assert_allclose(forecast.errors.temperature_k, sigma)
    assert forecast.errors.log_pressure > usual.errors.log_pressure


def test_model_levels_in_grib_give_the_same_air():
    fields = on_model_levels(still_air, NORTH, EAST, TIMES[:1], 400.0)
    field = read(as_grib(fields))
    assert field.on_model_levels
    levels, notes = column(field)
    assert [note.code for note in notes] == ["MODEL-UNDERGROUND"]
    h = levels.h_m[1:]
    assert h.size > 35
    assert_within(levels.temperature_k[1:], temperature_k(h), 0.02)
    assert_allclose(levels.pressure_pa[1:], TRUE_AIR.pressure_pa(h), rtol=2e-4)
    assert_allclose(levels.vapour_pressure_pa[1:], vapour_pressure_pa(h), rtol=5e-3)


def with_wrong_level(fields, dimension, level, kelvin):
    is_wrong = fields[dimension] == level
    return fields.assign(t=fields.t + kelvin * is_wrong)


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


@pytest.mark.parametrize("case", MODEL_LEVELS_REFUSED)
def test_model_levels_that_make_no_column_are_refused(case):
    change, code, words = MODEL_LEVELS_REFUSED[case]
    whole = on_model_levels(air, NORTH, (8.0, 9.0), TIMES[:1], 400.0)
    with refused_with(code, words):
        read(as_netcdf(change(whole)))


@pytest.mark.parametrize("ground_m", [150.0, 400.0])
def test_a_low_ground_in_metres_without_a_unit_is_found_by_the_missions(ground_m):
    """As geopotential it would lie at a tenth, and all levels with it."""
    fields = on_model_levels(still_air, NORTH, EAST, TIMES, ground_m)
    with refused_with("MODEL-UNITS", f"in metres at {ground_m:.0f} m"):
        column_of(in_metres(fields), ground_h_m=ground_m)


@pytest.mark.parametrize("ground_m", [900.0, 2000.0])
def test_a_high_ground_in_metres_without_a_unit_is_found_by_pressure(ground_m):
    fields = on_model_levels(still_air, NORTH, EAST, TIMES, ground_m)
    ledger = Ledger()
    usual, _ = column_of(fields, ground_h_m=ground_m, ledger=ledger)
    assert not list(ledger)

    same, _ = column_of(in_metres(fields), ground_h_m=ground_m, ledger=ledger)

    assert_within(same.h_m, usual.h_m, 0.1)
    (entry,) = ledger
    assert entry.code == "MODEL-GROUND-UNIT"
    assert entry.count == 12


def test_gfs_has_relative_humidity_and_geopotential_metres():
    """Around Greenwich, longitudes from 0 to 360 in a file that goes round the earth."""
    times = ("2026-05-14T09", "2026-05-14T12")
    around = (0.0, 90.0, 180.0, 270.0)
    gfs = dataset(still_air, NORTH, around, times, PRESSURE_LEVELS[::3])
    gfs = relative(gfs)
    gfs = gfs.assign(gh=gfs.z / 9.80665).drop_vars("z")
    path = as_grib(gfs, lead_h=3)
    place = (PLACE[0], np.radians(-45.0))

    read_column, _ = column(read(path, place), place)

    rows = on_levels(read_column)
    h = read_column.h_m[rows]
    assert_within(read_column.temperature_k[rows], temperature_k(h), 0.02)
    low = h < 7000.0
    vapour = read_column.vapour_pressure_pa[rows][low]
    assert_allclose(vapour, vapour_pressure_pa(h[low]), rtol=1e-2)


@pytest.mark.parametrize("first", [178.5, -181.5])
@pytest.mark.parametrize("longitude", [179.9, -180.1])
def test_across_the_date_line(fields, first, longitude):
    east = (first + np.arange(3.0) + 180.0) % 360.0 - 180.0
    over = fields.assign_coords(longitude=east).sortby("longitude")
    place = (PLACE[0], np.radians(longitude))

    read_column, _ = column_of(over, place)

    # The nodes keep their columns: 1 K a degree eastwards, half a degree from node to node.
    warmer = 1.0 + 0.5 * (179.9 - 178.5)
    rows = on_levels(read_column)
    expected = temperature_k(read_column.h_m[rows]) + warmer
    assert_within(read_column.temperature_k[rows], expected, 0.02)


def test_pressures_in_the_wrong_unit_are_repaired_and_reported(fields):
    wrong = with_levels(fields, fields.pressure_level.values, units="Pa")
    ledger = Ledger()

    field = read(as_netcdf(wrong), ledger=ledger)

    assert field.level[-1] == 100_000.0
    (repaired,) = ledger
    assert repaired.code == "MODEL-PRESSURE-UNIT"
    assert "1000 Pa" in repaired.what


def spoiled(fields, name, values):
    """Other values under the attributes of a field."""
    return fields.assign({name: values.assign_attrs(fields[name].attrs)})


def projected(fields):
    grid = {"grid_mapping_name": "lambert_conformal_conic"}
    in_grid = fields.rename(latitude="y", longitude="x")
    return in_grid.drop_vars(["x", "y"]).assign(crs=((), 0, grid))


def rotated(fields):
    grid = {"grid_mapping_name": "rotated_latitude_longitude"}
    return fields.assign(pole=((), 0, grid))


def on_hybrid_levels(fields):
    attributes = {"units": "hPa", "long_name": "hybrid level"}
    levels = ("pressure_level", fields.pressure_level.values, attributes)
    return fields.assign_coords(lev=levels).swap_dims(pressure_level="lev")


def with_humidity_of_one_time(fields):
    humidity = fields[["q"]].isel(valid_time=0, drop=True)
    return xarray.merge([fields.drop_vars("q"), humidity])


def with_humidity_of_another_day(fields):
    first = fields.isel(valid_time=[0])
    humidity = first[["q"]].rename(valid_time="time")
    another_day = np.array(["2017-01-01"], "M8[ns]")
    humidity = humidity.assign_coords(time=another_day)
    return xarray.merge([first.drop_vars("q"), humidity])


def with_ground_at_12_km(fields, units):
    ground = fields.z[0, 0] * 0.0 + 12_000.0
    return fields.assign(orog=ground.assign_attrs(units=units))


REFUSED = {
    "no humidity": (
        lambda f: f.drop_vars("q"),
        "MODEL-VARIABLE",
        "no specific or relative humid",
    ),
    "no geopotential": (
        lambda f: f.drop_vars("z"),
        "MODEL-VARIABLE",
        "no geopotential on levels",
    ),
    "three levels": (
        lambda f: f.isel(pressure_level=[0, 5, 9]),
        "MODEL-LEVELS",
        r"3 levels in all \(775, 875, 1000 hPa\)",
    ),
    "a member to choose": (
        lambda f: two_members(f, f),
        "MODEL-MEMBER",
        "members 0 to 1, and none is chosen",
    ),
    "projected": (
        projected,
        "MODEL-GRID",
        "lambert_conformal_conic",
    ),
    "rotated": (
        rotated,
        "MODEL-GRID",
        "its grid is rotated_latitude_longitude",
    ),
    "Celsius": (
        lambda f: spoiled(f, "t", f.t - 273.15),
        "MODEL-UNITS",
        "temperatures",
    ),
    "g/kg": (
        lambda f: spoiled(f, "q", 1000.0 * f.q),
        "MODEL-UNITS",
        "8.79.*: neither kg",
    ),
    "humidity missing as -9999": (
        lambda f: spoiled(f, "q", f.q.where(f.pressure_level != 700.0, -9999.0)),
        "MODEL-UNITS",
        "humidity from -9999 up to",
    ),
    "a mixing ratio called r": (
        lambda f: f.rename(q="r"),
        "MODEL-UNITS",
        "relative humidity from",
    ),
    "hybrid levels that look like pressures": (
        on_hybrid_levels,
        "MODEL-VARIABLE",
        "no lnsp",
    ),
    "feet": (
        lambda f: spoiled(f, "z", f.z / 0.3048),
        "MODEL-UNITS",
        "as thick",
    ),
    "levels of the stratosphere": (
        lambda f: f.assign_coords(pressure_level=f.pressure_level / 7.0),
        "MODEL-UNITS",
        "not near the ground",
    ),
    "humidity of other times": (
        with_humidity_of_one_time,
        "MODEL-VARIABLE",
        "time",
    ),
    "humidity of another day": (
        with_humidity_of_another_day,
        "MODEL-VARIABLE",
        "time",
    ),
    "a ground in meters that would be geopotential": (
        lambda f: with_ground_at_12_km(f, "meters"),
        "MODEL-UNITS",
        "ground",
    ),
    "a high ground": (
        lambda f: with_ground_at_12_km(f, "m"),
        "MODEL-UNITS",
        "ground",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_such_field_is_refused_with_its_numbers(fields, case):
    change, code, words = REFUSED[case]
    with refused_with(code, words):
        read(as_netcdf(change(fields)))


LAMBERT = (
    "gridType=lambert,Nx=3,Ny=2,DxInMetres=3000,DyInMetres=3000,shortName=t,"
    "latitudeOfFirstGridPointInDegrees=40.0,longitudeOfFirstGridPointInDegrees=260.0,"
    "LoVInDegrees=262.5,LaDInDegrees=38.5,Latin1InDegrees=38.5,Latin2InDegrees=38.5"
)


def test_a_projected_grib_such_as_hrrr_is_refused_by_name():
    path = Path("hrrr.grib2")
    messages = [f"{LAMBERT},level={level}" for level in (1000, 850, 700, 500, 300)]
    write_grib(path, messages, values=np.full(6, 280.0))
    with refused_with("MODEL-GRID", "its grid is lambert"):
        read(path)


@pytest.mark.parametrize("name", ["forecast_reference_time", "reftime"])
def test_the_lead_time_of_a_forecast_counts_from_its_run(fields, name):
    forecast = fields.assign_coords({name: np.datetime64("2026-05-12T10:30", "ns")})
    field = read(as_netcdf(forecast))
    assert field.lead_h.tolist() == [47.5, 48.5]


def test_the_lead_time_of_a_forecast_is_its_step(fields):
    by_step = fields.isel(valid_time=[0]).rename(valid_time="time")
    by_step = by_step.assign_coords(
        time=[np.datetime64("2026-05-12T10:30", "ns")],
        step=np.timedelta64(48, "h").astype("m8[ns]"),
    )

    field = read(as_netcdf(by_step))

    assert field.time_ns.tolist() == [NOON]
    assert field.lead_h.tolist() == [48.0]


def test_hours_between_the_times_of_a_file_are_too_far_from_both(fields):
    day_ns = 86_400 * 10**9
    flown_ns = NOON + np.array([-day_ns, 0, day_ns])
    times = flown_ns[::2].astype("M8[ns]")
    path = as_netcdf(fields.assign_coords(valid_time=times))
    area = FlightArea(
        np.full(3, PLACE[0]),
        np.full(3, PLACE[1]),
        flown_ns,
    )
    with refused_with("MODEL-TIME", r"24\.0 h away"):
        read_model_field(path, area, Ledger())


def test_another_member_than_the_file_has_is_refused(fields):
    third = as_netcdf(fields.assign_coords(number=3))
    assert read(third, member=3).time_ns.size == 2
    with refused_with("MODEL-MEMBER", "members"):
        read(third, member=4)


def test_a_member_of_a_file_without_any_is_refused(fields):
    with refused_with("MODEL-MEMBER", "members"):
        read(as_netcdf(fields), member=0)


def refuse_place(fields, latitude, longitude, time_ns=NOON):
    place = np.radians([[latitude], [longitude]])
    field = read(as_netcdf(fields), place, time_ns)
    field.refuse_outside(*place)


@pytest.mark.parametrize(
    ("when", "hours"),
    [("2026-05-14T18:30", "7.5 h away"), ("2025-05-14T10:30", "8759.5 h away")],
)
def test_another_time_is_refused_with_the_distance(fields, when, hours):
    with refused_with("MODEL-TIME", hours):
        refuse_place(fields, 47.3, 8.6, ns(when))


@pytest.mark.parametrize(
    ("longitude", "latitude", "distance"),
    [
        (8.6, 49.0, "111 km from its nodes"),
        (12.0, 47.3, "226 km from its nodes"),
        (-171.5, 47.3, "km from its nodes"),
    ],
)
def test_another_place_is_refused_with_the_distance(fields, longitude, latitude, distance):
    with refused_with("MODEL-AREA", distance):
        refuse_place(fields, latitude, longitude)


def counts_of(notes) -> dict[str, int]:
    return {note.code: note.count for note in notes}


def test_levels_with_missing_values_and_under_the_ground_are_left_out_and_counted(fields):
    holes = fields.copy(deep=True)
    holes.t[:, 8, 0, 1] = np.nan
    levels, notes = column_of(holes, ground_h_m=1000.0)
    assert counts_of(notes) == {"MODEL-MISSING": 1, "MODEL-UNDERGROUND": 4}
    assert not np.isclose(levels.pressure_pa, 80_000.0).any()


def test_a_column_ends_where_all_levels_above_are_missing(fields):
    low = fields.copy(deep=True)
    low.z[:, 12:] = np.nan  # from 650 hPa up
    levels, notes = column_of(low, ground_h_m=1000.0)
    assert counts_of(notes)["MODEL-MISSING"] == fields.pressure_level.size - 12
    assert levels.h_m[-1] < 4000.0
    low.t[:, 4:, 0, 1] = np.nan
    with refused_with("MODEL-LEVELS", "0 levels above the ground"):
        column_of(low, ground_h_m=1000.0)


@pytest.mark.parametrize(
    ("hpa", "kelvin"),
    [
        (950, -30.0),
        (850, 30.0),
        (700, -30.0),
        (500, 30.0),
        (350, -30.0),
    ],
)
def test_a_single_wrong_level_is_refused_with_its_number(fields, hpa, kelvin):
    wrong = with_wrong_level(fields, "pressure_level", hpa, kelvin)
    with refused_with("MODEL-LEVELS", f"K on {hpa} hPa.*this does not occur in air"):
        read(as_netcdf(wrong))


def test_a_layer_that_is_not_as_thick_as_its_air_is_told_of(fields):
    """A cold lowest level could be an inversion; its height says that it is none."""
    cold = with_wrong_level(fields, "pressure_level", 1000.0, -28.0)
    levels, (layer,) = column_of(cold, ground_h_m=50.0)
    assert layer.code == "MODEL-LAYER"
    assert "between 1000 and 975 hPa" in layer.what
    assert levels.pressure_pa[0] > 99_000.0


def test_below_the_lowest_level_sigma_grows(fields):
    high = fields.isel(pressure_level=slice(9, None))
    levels, (extended,) = column_of(high)
    assert extended.code == "MODEL-EXTENDED"
    assert levels.h_m[0] == pytest.approx(450.0)
    lowest_m = np.interp(77_500.0, PRESSURE[::-1], H[::-1])
    extrapolation_k = 8e-3 * (lowest_m - 450.0)
    sigma = levels.errors.temperature_k
    assert sigma[0] == pytest.approx(np.hypot(1.0, extrapolation_k), rel=0.02)
    assert (np.diff(sigma) <= 0.0).all()
    # 6.5 K/km, hydrostatic: the air is about 6.9 K/km with an inversion, so p is near.
    assert levels.pressure_pa[0] == pytest.approx(TRUE_AIR.pressure_pa(450.0), rel=5e-3)
    assert levels.errors.log_pressure > 2e-3


@pytest.mark.parametrize("ground_m", [None, 600.0, np.nan])
def test_a_ground_that_nobody_knows_is_the_models(fields, ground_m):
    if ground_m is not None:
        ground = fields.z[:, 0] * 0.0 + ground_m
        fields = fields.assign(orog=ground.assign_attrs(units="m"))
    _, notes = column_of(fields, ground_h_m=float("nan"))
    (entry,) = with_code(notes, "MODEL-GROUND")
    assert ("600 m" in entry.what) == (ground_m == 600.0)


@pytest.mark.shared("nwp")
def test_era5_at_a_node_to_the_last_digit():
    path = MODELS / "era5_pressure_levels_20180327T13.nc"
    raw = {}
    with netcdf_file(path, mmap=False) as file:
        for name, packed in file.variables.items():
            scale = getattr(packed, "scale_factor", 1.0)
            raw[name] = packed.data * scale + getattr(packed, "add_offset", 0.0)
    j = 9
    k = 30
    place = np.radians([raw["latitude"][j], raw["longitude"][k]])
    time_ns = ns("2018-03-27T13:00")

    field = read(path, place, time_ns)
    levels, _ = column(field, place, time_ns, ground_h_m=0.0)

    used = on_levels(levels)
    assert used.sum() > 15
    hpa = np.round(levels.pressure_pa[used] / 100.0)
    rows = [raw["level"].tolist().index(level) for level in hpa]
    t, q, z = (raw[name][0, rows, j, k] for name in "tqz")
    p = 100.0 * raw["level"][rows]
    assert_allclose(levels.temperature_k[used], t, rtol=1e-6)
    assert_allclose(levels.pressure_pa[used], p, rtol=1e-6)
    e = p * q / (0.622 + 0.378 * q)
    assert_allclose(levels.vapour_pressure_pa[used], e, rtol=1e-6)
    h = normal_gravity(place[0]).height(z / 9.80665)
    assert_allclose(levels.h_m[used], h, rtol=1e-6)


@pytest.mark.shared("nwp")
@pytest.mark.parametrize(
    ("name", "when", "place", "ground"),
    [
        (
            "era5_model_levels_20220829T17.nc",
            "2022-08-29T17:00",
            (70.25, -156.5),
            np.nan,
        ),
        (
            "era5_pressure_levels_20180327T13.nc",
            "2018-03-27T13:00",
            (20.0, -95.0),
            0.0,
        ),
        (
            "era5_pressure_levels_20180327T13.nc",
            "2018-03-27T13:00",
            (21.0, -103.0),
            1500.0,
        ),
    ],
)
def test_pressure_between_real_levels_is_that_of_an_ode_from_the_nearer_level(
    name, when, place, ground
):
    """Integrated here, T_M linear in height; linear in ln p differs by 1e-6.

    From level to level it misses by 3e-6 on model levels and up to 1.7e-4 on pressure levels, whose
    file rounds heights to 0.73 m (8.8e-5 of p) and has 37 of 137 levels: half of that between them.
    """
    place = np.radians(place)
    time_ns = ns(when)

    field = read(MODELS / name, place, time_ns)
    levels, _ = column(field, place, time_ns, ground_h_m=ground)

    height = normal_gravity(place[0]).geopotential_height(levels.h_m)
    p = levels.pressure_pa
    virtual = levels.temperature_k / (1.0 - 0.378 * levels.vapour_pressure_pa / p)
    fine = np.linspace(height[0], height[-1], 100_001)
    fall = 9.80665 * 28.9644 / 8314.32 / np.interp(fine, height, virtual)
    log_p = np.log(p[0]) - cumulative_trapezoid(fall, fine, initial=0.0)
    missed = np.interp(height, fine, log_p) - np.log(p)
    apart = np.abs(np.diff(missed))
    assert 0.5 * apart.max() < 1e-4
    assert np.median(apart) < 1e-4


@pytest.mark.shared("nwp")
def test_a_real_file_with_too_few_levels_says_which():
    with refused_with("MODEL-LEVELS", r"2 levels in all \(500, 850 hPa\)"):
        read(MODELS / "era5_two_levels_members.grib", time_ns=ns("2017-01-01T12"))
