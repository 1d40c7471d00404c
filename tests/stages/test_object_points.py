"""Ground heights from a table of object points; truth is the simulator's list of points."""

import numpy as np
import pandas as pd
import pyproj
import pytest
from numpy.testing import assert_allclose

from tests.helpers import entry_of
from tests.stages.other_logs import refusal_to_read
from tests.stages.terrain_models import gtx

GEOGRAPHIC = {"latitude": "lat_deg", "longitude": "lon_deg"}
PROJECTED = {"x": "east", "y": "north"}


@pytest.fixture
def table(flown):
    """The points of the simulated mission."""
    table = pd.read_parquet(flown.truth / "points.parquet")
    to_grid = pyproj.Proj("EPSG:25832")
    table["east"], table["north"] = to_grid(table["lon_deg"], table["lat_deg"])
    return table


def state(
    mission,
    table,
    height="h_msl_m",
    *,
    reference="msl",
    crs="EPSG:4326",
    places=GEOGRAPHIC,
    name="points.csv",
):
    path = mission.folder / name
    if name.endswith("csv"):
        table.to_csv(path, index=False)
    else:
        table.to_parquet(path)
    points = {
        "points": name,
        "columns": {"point": "point", "height": height, **places},
        "crs": crs,
    }
    mission.config["ground"] = {"height": points, "reference": reference}


def write_geoid(mission, undulation_m):
    """A grid of 4 rows from 46 degrees north and 4 columns from 7 degrees east, a degree apart."""
    content = gtx(46.0, 7.0, 1.0, np.broadcast_to(undulation_m, (4, 4)))
    (mission.folder / "own.gtx").write_bytes(content)
    mission.config["mission"]["geoid"] = "own.gtx"


def assert_heights(mission, expected):
    assert_allclose(mission.results()["h_g_m"], expected, atol=1e-3)


@pytest.mark.parametrize("name", ["points.csv", "points.parquet"])
def test_heights_by_name_are_those_of_the_column(mission, table, baseline, name):
    state(mission, table.sample(frac=1.0, random_state=1), name=name)
    manifest = mission.run_to_manifest()
    assert_heights(mission, baseline.results()["h_g_m"])
    assert "object points" in {item["role"] for item in manifest["inputs"]}
    assert entry_of(manifest, "CRS-DATUM")["kind"] == "note"


def above_the_ellipsoid(mission, table):
    state(mission, table, "h_ellipsoid_m", reference="ellipsoid")


def in_a_compound_system(mission, table):
    state(mission, table, crs="EPSG:25832+5773", places=PROJECTED)


def above_the_take_off(mission, table):
    table["h_msl_m"] -= 450.0
    state(mission, table, reference="relative", crs="EPSG:25832", places=PROJECTED)
    mission.config["ground"]["home_h_msl_m"] = 450.0


def in_a_national_datum(mission, table):
    """0.3 m above the mission's undulation of 47.6 m."""
    table["h_msl_m"] -= 0.3
    state(mission, table, crs="EPSG:25832+7837", places=PROJECTED)
    assert "mission.geoid" in refusal_to_read(mission, "CRS-VERTICAL")
    write_geoid(mission, 47.9)


@pytest.mark.parametrize(
    "write",
    [
        above_the_ellipsoid,
        in_a_compound_system,
        above_the_take_off,
        in_a_national_datum,
    ],
)
def test_every_datum_ends_in_the_same_height(mission, table, baseline, write):
    write(mission, table)
    mission.run_to_manifest()
    assert_heights(mission, baseline.results()["h_g_m"])


def test_the_undulation_is_that_of_the_point(mission_factory, table, tmp_path):
    """NavSatFix is ellipsoidal: the geoid alone relates both ends, each at its own place."""
    mission = mission_factory(tmp_path / "mcap", "mcap")
    del mission.config["mission"]["undulation_m"]
    rows = 46.0 + np.arange(4.0)[:, None]
    write_geoid(mission, steep_undulation(rows))
    above_the_ellipsoid(mission, table)
    mission.run_to_manifest()
    point = mission.results()["point"].to_pandas()
    points = table.set_index("point").loc[point]
    undulation = steep_undulation(points["lat_deg"])
    assert np.ptp(undulation) > 1.0
    assert_heights(mission, points["h_ellipsoid_m"] - undulation)


def steep_undulation(lat_deg):
    """47 m in the middle and 30 m more in each degree to the north."""
    return 47.0 + 30.0 * (lat_deg - 47.4)


def test_points_that_the_table_lacks_have_no_ground(mission, table):
    points = mission.measurements()["point"].to_pandas()
    is_missing = points == points[0]
    state(mission, table[table["point"] != points[0]])
    manifest = mission.run_to_manifest(3)
    count = is_missing.sum()
    assert manifest["observations"]["status"]["no_ground"] == count
    assert entry_of(manifest, "POINTS-MISSING")["count"] == count


def test_a_part_of_the_points_that_is_far_away_is_a_loss(mission, table):
    table["lat_deg"] += 1.5
    state(mission, table)
    assert entry_of(mission.run_to_manifest(3), "POINTS-FAR")["kind"] == "loss"


EXCHANGED = {"latitude": "lon_deg", "longitude": "lat_deg"}
EAST_FOR_NORTH = {"x": "north", "y": "east"}


@pytest.mark.parametrize(
    ("places", "crs", "code", "words"),
    [
        (EXCHANGED, "EPSG:4326", "POINTS-FAR", "with latitude and longitude exchanged"),
        (EAST_FOR_NORTH, "EPSG:25832", "CRS-AREA", ""),
        (PROJECTED, "EPSG:32633", "POINTS-FAR", "km from the stations"),
        (GEOGRAPHIC, "EPSG:99999", "CRS-UNKNOWN", "ground.height.crs"),
    ],
)
def test_wrong_places_of_points_are_refused(mission, table, places, crs, code, words):
    state(mission, table, places=places, crs=crs)
    assert words in refusal_to_read(mission, code)


def test_a_system_whose_heights_are_not_those_that_are_stated(mission, table):
    state(mission, table, "h_ellipsoid_m", crs="EPSG:4979")
    assert "but msl are stated" in refusal_to_read(mission, "CRS-VERTICAL")


@pytest.mark.parametrize("name", ["points.csv", "points.parquet"])
def test_a_column_of_heights_that_is_not_there(mission, table, name):
    state(mission, table, "h_mls_m", name=name)
    assert "h_msl_m" in refusal_to_read(mission, "POINTS-COLUMN")


@pytest.mark.parametrize("name", ["points.csv", "points.parquet"])
def test_heights_that_are_not_numbers(mission, table, name):
    state(mission, table.assign(h_msl_m="high"), name=name)
    refusal_to_read(mission, "POINTS-TABLE")


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda t: pd.concat([t, t.head(2)]), "POINTS-REPEATED", "2 points occur more than once"),
        (lambda t: t.assign(point="q" + t["point"]), "POINTS-MISSING", "p0"),
        (lambda t: t.head(0), "POINTS-EMPTY", ""),
    ],
    ids=["repeated", "of other names", "none"],
)
def test_tables_of_other_points_are_refused(mission, table, change, code, words):
    state(mission, change(table))
    assert words in refusal_to_read(mission, code)


def test_a_table_of_points_that_is_not_there(mission, table):
    state(mission, table)
    (mission.folder / "points.csv").unlink()
    assert "ground.height.points" in refusal_to_read(mission, "INPUT-MISSING")


def test_implausible_heights_of_points_are_counted(mission, table):
    table["h_msl_m"] *= 100.0
    state(mission, table)
    manifest = mission.run_to_manifest(3)
    count = manifest["observations"]["rows"]
    assert entry_of(manifest, "OBS-GROUND-RANGE")["count"] == count
