"""Ground heights from a table of object points; truth is the simulator's list of points."""

from __future__ import annotations

import struct

import numpy as np
import pandas as pd
import pyproj
import pytest

from tests.helpers import entry_of, refused
from unbend.batch.runs import read_mission

pytestmark = pytest.mark.usefixtures("plain_report")

GEOGRAPHIC = {"latitude": "lat_deg", "longitude": "lon_deg"}
PROJECTED = {"x": "east", "y": "north"}


@pytest.fixture
def surveyed(mission, flown):
    """The simulated mission, and its table of points as simulated."""
    table = pd.read_parquet(flown.truth / "points.parquet")
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:25832", always_xy=True)
    table["east"], table["north"] = to_grid.transform(table["lon_deg"], table["lat_deg"])
    return mission, table


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
    table.to_csv(path, index=False) if name.endswith("csv") else table.to_parquet(path)
    columns = {"point": "point", "height": height, **places}
    mission.config["ground"] = {
        "height": {"points": name, "columns": columns, "crs": crs},
        "reference": reference,
    }


def write_geoid(mission, south_deg: float, west_deg: float, undulation_m) -> None:
    """A grid of 4 rows from the south and 4 columns, a degree apart."""
    head = struct.pack(">4d2i", south_deg, west_deg, 1.0, 1.0, 4, 4)
    values = np.broadcast_to(undulation_m, (4, 4)).astype(">f4")
    (mission.folder / "own.gtx").write_bytes(head + values.tobytes())
    mission.config["mission"]["geoid"] = "own.gtx"


def heights(mission) -> np.ndarray:
    return mission.results()["h_g_m"].to_numpy()


@pytest.mark.parametrize("name", ["points.csv", "points.parquet"])
def test_heights_by_name_are_those_of_the_column(surveyed, baseline, name):
    mission, table = surveyed
    state(mission, table.sample(frac=1.0, random_state=1), name=name)
    manifest = mission.run_to_manifest()
    np.testing.assert_allclose(heights(mission), heights(baseline), atol=1e-3)
    assert "object points" in {item["role"] for item in manifest["inputs"]}
    assert entry_of(manifest, "CRS-DATUM")["kind"] == "note"


def above_the_ellipsoid(mission, table) -> None:
    state(mission, table, "h_ellipsoid_m", reference="ellipsoid")


def in_a_compound_system(mission, table) -> None:
    state(mission, table, crs="EPSG:25832+5773", places=PROJECTED)


def above_the_take_off(mission, table) -> None:
    above = table.assign(above_home=table["h_msl_m"] - 450.0)
    state(mission, above, "above_home", reference="relative", crs="EPSG:25832", places=PROJECTED)
    mission.config["ground"]["home_h_msl_m"] = 450.0


def in_a_national_datum(mission, table) -> None:
    """0.3 m above the mission's undulation of 47.6 m."""
    national = table.assign(national=table["h_msl_m"] - 0.3)
    state(mission, national, "national", crs="EPSG:25832+7837", places=PROJECTED)
    with refused("CRS-VERTICAL") as refusal:
        read_mission(mission.save())
    assert "mission.geoid" in str(refusal.value)
    write_geoid(mission, 46.0, 7.0, 47.9)


@pytest.mark.parametrize(
    "stated", [above_the_ellipsoid, in_a_compound_system, above_the_take_off, in_a_national_datum]
)
def test_every_datum_ends_in_the_same_height(surveyed, baseline, stated):
    mission, table = surveyed
    stated(mission, table)
    mission.run_to_manifest()
    np.testing.assert_allclose(heights(mission), heights(baseline), atol=1e-3)


def test_the_undulation_is_that_of_the_point(mission_factory, flown, tmp_path):
    """NavSatFix is ellipsoidal: the geoid alone relates both ends, each at its own place."""
    mission = mission_factory(tmp_path / "mcap", "mcap")
    del mission.config["mission"]["undulation_m"]
    table = pd.read_parquet(flown.truth / "points.parquet")
    # 47 m in the middle and 30 m more in each degree to the north.
    rows = 46.0 + np.arange(4.0)[:, None]
    write_geoid(mission, 46.0, 7.0, 47.0 + 30.0 * (rows - 47.4))
    state(mission, table, "h_ellipsoid_m", reference="ellipsoid")
    mission.run_to_manifest()
    points = table.set_index("point").loc[mission.results()["point"].to_pandas()]
    undulation = 47.0 + 30.0 * (points["lat_deg"] - 47.4)
    assert undulation.max() - undulation.min() > 1.0
    wanted = points["h_ellipsoid_m"] - undulation
    np.testing.assert_allclose(heights(mission), wanted, atol=1e-3)


def test_points_that_the_table_lacks_have_no_ground(surveyed):
    mission, table = surveyed
    seen = mission.measurements()["point"].to_pandas()
    missing = seen.iloc[0]
    state(mission, table[table["point"] != missing])
    manifest = mission.run_to_manifest(3)
    count = int((seen == missing).sum())
    assert manifest["observations"]["status"]["no_ground"] == count
    assert entry_of(manifest, "POINTS-MISSING")["count"] == count


def test_a_part_of_the_points_that_is_far_away_is_a_loss(surveyed):
    mission, table = surveyed
    state(mission, table.assign(lat_deg=table["lat_deg"] + 1.5))
    assert entry_of(mission.run_to_manifest(3), "POINTS-FAR")["kind"] == "loss"


def high(table):
    return table.assign(h_msl_m="high")


@pytest.mark.parametrize(
    ("change", "stated", "code", "words"),
    [
        (
            None,
            {"places": {"latitude": "lon_deg", "longitude": "lat_deg"}},
            "POINTS-FAR",
            "with latitude and longitude exchanged",
        ),
        (None, {"places": {"x": "north", "y": "east"}, "crs": "EPSG:25832"}, "CRS-AREA", ""),
        (None, {"places": PROJECTED, "crs": "EPSG:32633"}, "POINTS-FAR", "km from the stations"),
        (None, {"crs": "EPSG:99999"}, "CRS-UNKNOWN", "ground.height.crs"),
        (
            None,
            {"height": "h_ellipsoid_m", "crs": "EPSG:4979"},
            "CRS-VERTICAL",
            "but msl are stated",
        ),
        (
            lambda table: pd.concat([table, table.head(2)]),
            {},
            "POINTS-REPEATED",
            "2 points occur more than once",
        ),
        (lambda table: table.assign(point="q" + table["point"]), {}, "POINTS-MISSING", "p0"),
        (lambda table: table.head(0), {}, "POINTS-EMPTY", ""),
        (None, {"height": "h_mls_m"}, "POINTS-COLUMN", "h_msl_m"),
        (None, {"height": "h_mls_m", "name": "points.parquet"}, "POINTS-COLUMN", "h_msl_m"),
        (high, {}, "POINTS-TABLE", ""),
        (high, {"name": "points.parquet"}, "POINTS-TABLE", ""),
        (None, {"places": {"x": "east"}}, "CONFIG-INVALID", "either latitude and longitude"),
    ],
)
def test_mistakes_in_a_table_of_points_are_refused(surveyed, change, stated, code, words):
    mission, table = surveyed
    state(mission, table if change is None else change(table), **stated)
    with refused(code) as refusal:
        read_mission(mission.save())
    assert words in str(refusal.value)


def test_a_table_of_points_that_is_not_there(surveyed):
    mission, table = surveyed
    state(mission, table)
    (mission.folder / "points.csv").unlink()
    with refused("INPUT-MISSING") as refusal:
        read_mission(mission.save())
    assert "ground.height.points" in str(refusal.value)


def test_implausible_heights_of_points_are_counted(surveyed):
    mission, table = surveyed
    state(mission, table.assign(h_msl_m=table["h_msl_m"] * 100.0))
    manifest = mission.run_to_manifest(3)
    count = manifest["observations"]["rows"]
    assert entry_of(manifest, "OBS-GROUND-RANGE")["count"] == count
