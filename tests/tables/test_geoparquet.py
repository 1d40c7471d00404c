"""stations.parquet as GeoParquet: geopandas and a validator read it. Truth: their own decoding."""

import json
from dataclasses import replace

import geopandas
import geoparquet_validator
import numpy as np
import pyarrow.parquet as pq
import pyproj
import pytest
from numpy.testing import assert_array_equal

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.flight.stations import empty_stations
from unbend.tables.writing import table_of_stations, write_parquet

SKIPPED_OF_POINTS = {
    "crs-consistency",
    "crs-default",
    "edges-value",
    "epoch",
    "orientation-value",
    "orientation-rings",
    "bbox-array",
    "bbox-crs",
    "bbox-extent",
    "media-type",
}


@pytest.fixture
def path(tmp_path):
    """Zurich with a height; Sydney with a height above sea level alone; one without a position."""
    names = np.array(["a,b.tif", "<c>.tif", "d.tif"], object)
    stations = replace(
        empty_stations(names, np.full(3, "nadir", object), "ok"),
        lat_rad=np.radians([47.4, -33.9, np.nan]),
        lon_rad=np.radians([8.5, 151.2, np.nan]),
        h_msl_m=np.array([452.0, 90.0, np.nan]),
        h_ellipsoid_m=np.array([499.5, np.nan, np.nan]),
        status=np.array(["ok", "ok", "in_gap"], object),
    )
    air = constant_series(TimedProfile(None, standard_atmosphere("us1976")), 3)
    file = tmp_path / "stations.parquet"
    write_parquet(table_of_stations(stations, air), file)
    return file


def test_geopandas_opens_it(path):
    frame = geopandas.read_parquet(path)
    zurich, sydney, nowhere = frame.geometry
    assert zurich.coords[0] == pytest.approx((8.5, 47.4, 499.5))
    assert sydney.coords[0] == pytest.approx((151.2, -33.9))
    assert nowhere is None
    assert frame.crs.equals(pyproj.CRS(4979))
    assert frame["image"].tolist() == ["a,b.tif", "<c>.tif", "d.tif"]


def test_a_validator_finds_nothing_wrong(path):
    report = geoparquet_validator.check(str(path))
    assert report["version"] == "1.1.0"
    assert geoparquet_validator.failed(report, "core") == []
    not_passed = set()
    for outcome in report["outcomes"]:
        _, is_core, name = outcome["id"].partition("/conf/core/")
        if is_core and outcome["status"] != "pass":
            not_passed.add(name)
    assert not_passed == SKIPPED_OF_POINTS


def test_the_geometry_is_the_last_column_and_the_units_stay(path):
    schema = pq.read_schema(path)
    assert schema.names[-1] == "geometry"
    assert b"unbend.conventions" in schema.metadata
    assert json.loads(schema.metadata[b"geo"])["primary_column"] == "geometry"


def test_a_run_writes_it(baseline):
    frame = geopandas.read_parquet(baseline.output / "stations.parquet")
    assert_array_equal(frame.geometry.x, frame["lon_deg"])
    assert_array_equal(frame.geometry.y, frame["lat_deg"])
    assert_array_equal(frame.geometry.z, frame["h_ellipsoid_m"])
