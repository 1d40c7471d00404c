"""Ground heights from a table of object points; truth is the simulator's list of points."""

from __future__ import annotations

import json
import struct

import numpy as np
import pandas as pd
import pyproj
import pytest

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


def ran(mission, exit_code=0) -> dict:
    ended = mission.run()
    assert ended.code == exit_code, ended.text
    return json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))


def refused(mission, code: str, exit_code: int = 6) -> str:
    ended = mission.run()
    assert (ended.code, code in ended.err) == (exit_code, True), ended.text
    return ended.err


def heights(mission) -> np.ndarray:
    return mission.results()["h_g_m"].to_numpy()


def told(manifest, code) -> dict:
    return next(entry for entry in manifest["ledger"] if entry["code"] == code)


@pytest.mark.parametrize("name", ["points.csv", "points.parquet"])
def test_heights_by_name_are_those_of_the_column(surveyed, baseline, name):
    mission, table = surveyed
    state(mission, table.sample(frac=1.0, random_state=1), name=name)
    manifest = ran(mission)
    np.testing.assert_allclose(heights(mission), heights(baseline), atol=1e-3)
    assert "object points" in {item["role"] for item in manifest["inputs"]}
    assert told(manifest, "CRS-DATUM")["kind"] == "note"


def test_every_datum_ends_in_the_same_height(surveyed, baseline):
    mission, table = surveyed
    wanted = heights(baseline)
    state(mission, table, "h_ellipsoid_m", reference="ellipsoid")
    ran(mission)
    np.testing.assert_allclose(heights(mission), wanted, atol=1e-3)
    state(mission, table, crs="EPSG:25832+5773", places=PROJECTED)
    ran(mission)
    np.testing.assert_allclose(heights(mission), wanted, atol=1e-3)
    table["above_home"] = table["h_msl_m"] - 450.0
    state(mission, table, "above_home", reference="relative", crs="EPSG:25832", places=PROJECTED)
    mission.config["ground"]["home_h_msl_m"] = 450.0
    ran(mission)
    np.testing.assert_allclose(heights(mission), wanted, atol=1e-3)
    # A national datum 0.3 m above the mission's undulation of 47.6 m.
    table["national"] = table["h_msl_m"] - 0.3
    state(mission, table, "national", crs="EPSG:25832+7837", places=PROJECTED)
    assert "mission.geoid" in refused(mission, "CRS-VERTICAL")
    head = struct.pack(">4d2i", 46.0, 7.0, 1.0, 1.0, 4, 4)
    grid = np.full(16, 47.9, ">f4").tobytes()
    (mission.folder / "national.gtx").write_bytes(head + grid)
    mission.config["mission"]["geoid"] = "national.gtx"
    ran(mission)
    np.testing.assert_allclose(heights(mission), wanted, atol=1e-3)


def test_the_undulation_is_that_of_the_point(mission_factory, flown, tmp_path):
    """NavSatFix is ellipsoidal: the geoid alone relates both ends, each at its own place."""
    mission = mission_factory(tmp_path / "mcap", "mcap")
    del mission.config["mission"]["undulation_m"]
    table = pd.read_parquet(flown.truth / "points.parquet")
    grid = {"south": 46.0, "slope": 0.5}
    # 47 m in the middle and 30 m more in each degree to the north.
    rows = 46.0 + np.arange(4) - 47.4
    values = np.repeat(47.0 + 30.0 * rows, 4).astype(">f4")
    head = struct.pack(">4d2i", grid["south"], 7.0, 1.0, 1.0, 4, 4)
    (mission.folder / "slope.gtx").write_bytes(head + values.tobytes())
    mission.config["mission"]["geoid"] = "slope.gtx"
    state(mission, table, "h_ellipsoid_m", reference="ellipsoid")
    ran(mission)
    by_name = table.set_index("point")
    point = mission.results()["point"].to_pandas()
    lat = by_name["lat_deg"].loc[point]
    h = by_name["h_ellipsoid_m"].loc[point]
    wanted = h.to_numpy() - (47.0 + 30.0 * (lat.to_numpy() - 47.4))
    assert np.ptp(wanted - h.to_numpy()) > 1.0
    np.testing.assert_allclose(heights(mission), wanted, atol=1e-3)


def test_points_that_the_table_lacks_have_no_ground(surveyed):
    mission, table = surveyed
    seen = mission.measurements()["point"].to_pandas()
    state(mission, table[table["point"] != seen.iloc[0]])
    manifest = ran(mission, 3)
    count = int((seen == seen.iloc[0]).sum())
    assert manifest["observations"]["status"]["no_ground"] == count
    assert told(manifest, "POINTS-MISSING")["count"] == count
    state(mission, table.assign(point="q" + table["point"]))
    assert "p0" in refused(mission, "POINTS-MISSING")


def test_mistakes_in_a_table_of_points(surveyed):
    mission, table = surveyed
    state(mission, table, places={"latitude": "lon_deg", "longitude": "lat_deg"})
    ended = refused(mission, "POINTS-FAR")
    assert "with latitude and longitude exchanged" in ended
    assert " km from the stations" in ended
    state(mission, table.assign(lat_deg=table["lat_deg"] + 1.5))
    assert told(ran(mission, 3), "POINTS-FAR")["kind"] == "loss"
    state(mission, table, places={"x": "north", "y": "east"}, crs="EPSG:25832")
    refused(mission, "CRS-AREA")
    state(mission, table, places=PROJECTED, crs="EPSG:32633")
    assert "km from the stations" in refused(mission, "POINTS-FAR")
    state(mission, table, crs="EPSG:99999")
    assert "ground.height.crs" in refused(mission, "CRS-UNKNOWN")
    state(mission, table, "h_ellipsoid_m", crs="EPSG:4979")
    assert "but msl are stated" in refused(mission, "CRS-VERTICAL")
    state(mission, pd.concat([table, table.head(2)]))
    assert "2 points occur more than once" in refused(mission, "POINTS-REPEATED")
    state(mission, table.head(0))
    refused(mission, "POINTS-EMPTY")
    for name in ("points.csv", "points.parquet"):
        state(mission, table, "h_mls_m", name=name)
        assert "h_msl_m" in refused(mission, "POINTS-COLUMN")
    state(mission, table.assign(h_msl_m="high"))
    refused(mission, "POINTS-TABLE")
    state(mission, table.assign(h_msl_m="high"), name="points.parquet")
    refused(mission, "POINTS-TABLE")
    state(mission, table, places={"x": "east"})
    assert "either latitude and longitude" in refused(mission, "CONFIG-INVALID", 2)
    state(mission, table)
    (mission.folder / "points.csv").unlink()
    assert "ground.height.points" in refused(mission, "INPUT-MISSING")


def test_implausible_heights_of_points_are_counted(surveyed):
    mission, table = surveyed
    state(mission, table.assign(h_msl_m=table["h_msl_m"] * 100.0))
    manifest = ran(mission, 3)
    assert told(manifest, "OBS-GROUND-RANGE")["count"] == manifest["observations"]["rows"]
