"""Ground heights from an elevation model; truth are the simulator's points on its terrain."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pyproj
import pytest
import rasterio
from rasterio import Affine

from tests.batch.test_rehearsal import rows
from unbend.batch.runs import check_mission
from unbend.simulate.flight import FIELD_LAT_RAD, FIELD_LON_RAD, geographic, terrain_m

pytestmark = pytest.mark.usefixtures("plain_report")

STEP_M = 10.0
CELLS = 1600
HOLE = -32768.0


def terrain_at(lat_deg, lon_deg):
    """The simulator's terrain at places, by its own linear map."""
    lat_1, lon_1 = geographic(np.array(1.0), np.array(1.0))
    north = (np.radians(lat_deg) - FIELD_LAT_RAD) / (float(lat_1) - FIELD_LAT_RAD)
    east = (np.radians(lon_deg) - FIELD_LON_RAD) / (float(lon_1) - FIELD_LON_RAD)
    return terrain_m(east, north)


def write(path, values, crs, transform, **options):
    profile = {
        "driver": "GTiff",
        "height": values.shape[0],
        "width": values.shape[1],
        "count": 1,
        "dtype": "float32",
        "crs": crs,
        "transform": transform,
        "tiled": True,
    } | options
    with rasterio.open(path, "w", **profile) as out:
        out.write(values.astype(profile["dtype"]), 1)


@pytest.fixture
def modelled(mission, flown):
    """Writes elevation models of the simulator's terrain, and sets the mission to use them."""

    def state(*, crs="EPSG:4326", change=None, columns=slice(None), name="dem.tif", **section):
        points = pd.read_parquet(flown.truth / "points.parquet")
        middle = points["lon_deg"].mean(), points["lat_deg"].mean()
        to_grid = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
        x, y = to_grid.transform(*middle)
        step = STEP_M if pyproj.CRS(crs).is_projected else STEP_M / 111_000.0
        west = x - CELLS / 2 * step
        north = y + CELLS / 2 * step
        at = (np.arange(CELLS) + 0.5) * step
        lon, lat = to_grid.transform(*np.meshgrid(west + at, north - at), direction="INVERSE")
        values = terrain_at(lat, lon)
        values = values if change is None else change(values)
        first = range(CELLS)[columns][0]
        file_crs = section.pop("file_crs", crs)
        write(
            mission.folder / name,
            values[:, columns],
            file_crs,
            Affine(step, 0.0, west + first * step, 0.0, -step, north),
            **section.pop("options", {}),
        )
        reference = section.pop("reference", "msl")
        height = {"dem": name} | {k: section.pop(k) for k in ("crs_stated",) if k in section}
        if "crs_stated" in height:
            height["crs"] = height.pop("crs_stated")
        mission.config["ground"] = {"height": height, "reference": reference, **section}

    return state


@pytest.fixture(scope="module")
def given(baseline):
    """Results by the true heights of the points."""
    return baseline.results().to_pandas()


def ran(mission, exit_code=0):
    ended = mission.run()
    assert ended.code == exit_code, ended.text
    manifest = json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))
    return manifest, mission.results().to_pandas()


def entry(manifest, code):
    return next(entry for entry in manifest["ledger"] if entry["code"] == code)


def refused(mission, code):
    ended = mission.run()
    assert (ended.code, code in ended.err) == (6, True), ended.text
    return ended.err


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:25832", "EPSG:3035"])
def test_heights_and_corrections_are_those_of_the_points(mission, modelled, given, crs):
    modelled(crs=crs, sigma_m=1.0)
    manifest, results = ran(mission)
    # Stations from the log are a metre or two off, and slopes are up to 1 in 10.
    np.testing.assert_allclose(results["h_g_m"], given["h_g_m"], atol=0.4)
    for column in ("x_corrected_px", "y_corrected_px"):
        np.testing.assert_allclose(results[column], given[column], atol=1e-4)
    assert (results["status"] == "ok").all()
    assert results["sigma_ground_dx_px"].notna().all()
    assert entry(manifest, "DEM-READ")["count"] == 1


def test_tiles_in_any_order_are_one_model(mission, modelled, given):
    for number, columns in enumerate((slice(797, None), slice(0, 801))):
        modelled(columns=columns, name=f"tile{number}.tif")
    mission.config["ground"]["height"]["dem"] = ["tile0.tif", "tile1.tif"]
    manifest, results = ran(mission)
    np.testing.assert_allclose(results["h_g_m"], given["h_g_m"], atol=0.4)
    assert not [e for e in manifest["ledger"] if e["code"] == "TIES-HEIGHT"]


def test_ellipsoidal_heights_are_reduced_by_the_undulation(mission, modelled, given):
    mission.config["mission"]["undulation_m"] = 47.0
    modelled(change=lambda z: z + 47.0, reference="ellipsoid")
    _, results = ran(mission)
    np.testing.assert_allclose(results["h_g_m"], given["h_g_m"], atol=0.4)


def test_feet_and_undeclared_holes(mission, modelled, given):
    modelled(change=lambda z: z / 0.3048)
    with rasterio.open(mission.folder / "dem.tif", "r+") as raster:
        raster.units = ["ft"]
    manifest, results = ran(mission)
    np.testing.assert_allclose(results["h_g_m"], given["h_g_m"], atol=0.4)
    assert "0.3048 m" in entry(manifest, "DEM-READ")["what"]


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda z: np.clip(z, 0, 255), id="a hillshade"),
        pytest.param(lambda z: z + 60.0, id="another zero"),
        pytest.param(
            lambda z: np.where(np.arange(CELLS) >= CELLS // 2, 0.0, z), id="zero in holes"
        ),
        pytest.param(lambda z: z[::-1], id="upside down"),
        pytest.param(lambda z: z[:, ::-1], id="east for west"),
        pytest.param(lambda z: z.T, id="axes exchanged"),
        pytest.param(lambda z: np.roll(z, CELLS // 4, axis=1), id="four kilometres beside"),
    ],
)
def test_tie_points_contradict_a_model_of_other_heights(mission, modelled, change):
    modelled(change=change)
    manifest, _ = ran(mission, 3)
    assert entry(manifest, "TIES-HEIGHT")["kind"] == "finding"


def test_a_model_in_feet_is_too_far_from_the_take_off(mission, modelled):
    """What tie points find follows from it, and is held back."""
    modelled(change=lambda z: z / 0.3048)
    manifest, _ = ran(mission, 3)
    assert entry(manifest, "PLAUSIBLE-GROUND")["kind"] == "finding"
    assert "likely feet" in entry(manifest, "PLAUSIBLE-GROUND")["what"]
    assert "TIES-HEIGHT" in entry(manifest, "TIES-HELD-BACK")["what"]


@pytest.mark.parametrize("known", ["nothing", "tie points", "take-off", "no model"])
def test_a_model_that_nothing_can_verify_is_said_to_be_so(mission, modelled, monkeypatch, known):
    """Upside down, and every point in one image: no check can see it, and the ledger says that."""
    if known == "take-off":  # the field lies in a wider model
        monkeypatch.setitem(globals(), "STEP_M", 40.0)
    if known != "no model":
        modelled(change=lambda z: z if known == "take-off" else z[::-1])
    if known != "tie points":
        rows(lambda table: table.__setitem__("point", table["point"] + table["image"]))(mission)
    ledger = check_mission(mission.save()).manifest.values["ledger"]
    found = {e["code"]: e["kind"] for e in ledger if e["kind"] != "note"}
    assert ("TIES-HEIGHT" in found) == (known == "tie points")
    assert found.get("DEM-UNVERIFIED") == ("warning" if known == "nothing" else None)
    assert "finding" not in found.values() or known == "tie points"


def test_a_model_said_to_be_in_the_next_zone_is_refused(mission, modelled):
    modelled(crs="EPSG:25832", file_crs=None, crs_stated="EPSG:25833")
    assert "6 of 6 stations" in refused(mission, "DEM-OUTSIDE")


def test_a_hole_under_half_of_the_block_is_flagged_with_its_number(mission, modelled, given):
    east = np.arange(CELLS) >= CELLS // 2

    def holed(z):
        return np.where(east[None, :], HOLE, z)

    modelled(change=holed)
    manifest, results = ran(mission, 3)
    missing = (results["status"] == "no_ground").to_numpy()
    assert 0 < missing.sum() < missing.size
    assert results["x_corrected_px"].isna()[missing].all()
    np.testing.assert_allclose(results["h_g_m"][~missing], given["h_g_m"][~missing], atol=0.4)
    flagged = [e for e in manifest["ledger"] if e["code"] == "OBS-FLAGGED"]
    assert sum(e["count"] for e in flagged) == missing.sum()


def test_a_model_that_lies_elsewhere_or_under_some(mission, modelled):
    modelled(columns=slice(0, 40))
    assert "6 of 6 stations" in refused(mission, "DEM-OUTSIDE")
    # East of the middle of the block there is none.
    modelled(columns=slice(0, CELLS // 2))
    manifest, results = ran(mission, 3)
    lost = entry(manifest, "DEM-OUTSIDE")
    stations = pd.read_parquet(mission.output / "stations.parquet")
    with rasterio.open(mission.folder / "dem.tif") as raster:
        beside = (stations["lon_deg"] > raster.bounds.right).to_numpy()
    assert 0 < beside.sum() < beside.size
    assert (lost["kind"], lost["count"]) == ("loss", beside.sum())
    assert (results["status"] == "no_ground").any()


def test_scale_and_offset_of_the_band_are_applied(mission, modelled, given):
    modelled(change=lambda z: np.round((z - 300.0) / 0.05), options={"dtype": "int16"})
    with rasterio.open(mission.folder / "dem.tif", "r+") as raster:
        raster.scales, raster.offsets = (0.05,), (300.0,)
    _, results = ran(mission)
    np.testing.assert_allclose(results["h_g_m"], given["h_g_m"], atol=0.45)


def test_what_contradicts_the_file_is_refused(mission, modelled):
    modelled(file_crs=None)
    assert "ground.height.crs" in refused(mission, "DEM-CRS")
    modelled(file_crs=None, crs_stated="EPSG:4326")
    ran(mission)
    modelled(crs_stated="EPSG:25832")
    assert "ETRS89 / UTM zone 32N is stated" in refused(mission, "DEM-CRS")
    modelled(file_crs="EPSG:4979")
    assert "ellipsoid" in refused(mission, "CRS-VERTICAL")
    modelled(crs="EPSG:25832", file_crs="EPSG:25832+7837")
    manifest, _ = ran(mission)
    assert entry(manifest, "DEM-READ")["kind"] == "warning"
    assert "DHHN2016" in entry(manifest, "DEM-READ")["what"]


def test_a_datum_that_needs_a_missing_grid_is_a_warning_with_its_name(mission, modelled):
    modelled(crs="EPSG:31467")  # DHDN: BETA2007, or Helmert to some metres
    manifest, _ = ran(mission)
    read = entry(manifest, "DEM-READ")
    assert read["kind"] == "warning"
    assert "needs de_adv_BETA2007.tif" in read["what"]


def index_of(name):
    """A GeoJSON that names one raster, which lies about the block."""
    ring = [[8.0, 48.0], [9.0, 48.0], [9.0, 49.0], [8.0, 49.0], [8.0, 48.0]]
    of_tile = {"type": "Polygon", "coordinates": [ring]}
    tile = {"type": "Feature", "properties": {"location": name}, "geometry": of_tile}
    return {"type": "FeatureCollection", "features": [tile]}


SERVICE = """<GDAL_WMS><Service name="TMS"><ServerUrl>http://127.0.0.1:9/${z}/${x}/${y}.tif</ServerUrl>
</Service><DataWindow><UpperLeftX>-180</UpperLeftX><UpperLeftY>90</UpperLeftY><LowerRightX>180
</LowerRightX><LowerRightY>-90</LowerRightY><TileLevel>3</TileLevel></DataWindow>
<Projection>EPSG:4326</Projection><BandsCount>1</BandsCount><DataType>Float32</DataType></GDAL_WMS>"""


def test_a_raster_of_no_heights_is_refused(mission, modelled):
    modelled()
    with rasterio.open(mission.folder / "dem.tif", "r+") as raster:
        raster.units = ["K"]
    assert "'K'" in refused(mission, "DEM-UNIT")
    modelled()
    with rasterio.open(mission.folder / "dem.tif", "r+") as raster:
        raster.transform = Affine(1e-4, 1e-5, 8.0, 0.0, -1e-4, 49.0)
    refused(mission, "DEM-RASTER")
    # An index of tiles and a service are files that name others, whose change nobody would see.
    modelled()
    tiles = mission.folder / "tiles.geojson"
    tiles.write_text(json.dumps(index_of(str(mission.folder / "dem.tif"))))
    index = f"<GDALTileIndexDataset><IndexDataset>{tiles}</IndexDataset></GDALTileIndexDataset>"
    mission.config["ground"]["height"]["dem"] = "dem.gti"
    for naming in (index, SERVICE):
        (mission.folder / "dem.gti").write_text(naming)
        assert "name the rasters" in refused(mission, "DEM-RASTER")
    mission.config["ground"]["height"]["dem"] = "dem.tif"
    (mission.folder / "dem.tif").write_bytes(b"no raster")
    refused(mission, "DEM-UNREADABLE")
    (mission.folder / "dem.tif").unlink()
    assert "ground.height.dem" in refused(mission, "INPUT-MISSING")


def test_rasters_beside_one_grid_are_refused(mission, modelled):
    modelled(name="a.tif")
    modelled(name="b.tif")
    with rasterio.open(mission.folder / "b.tif", "r+") as raster:
        a = raster.transform
        raster.transform = Affine(a.a, 0.0, a.c + 0.5 * a.a, 0.0, a.e, a.f)
    mission.config["ground"]["height"]["dem"] = ["a.tif", "b.tif"]
    assert "0.5 cells" in refused(mission, "DEM-TILES")


def test_without_rasterio_it_says_what_to_install(mission, modelled, monkeypatch):
    modelled()
    monkeypatch.setitem(__import__("sys").modules, "rasterio", None)
    assert "unbend[rasters]" in refused(mission, "DEM-RASTERIO")


def test_ideal_observations_are_displaced_by_the_same_ground(mission, modelled, given):
    modelled()
    mission.config["refraction"] = {"direction": "apply"}
    _, results = ran(mission, 3)  # PLAUSIBLE-APPLY: these were measured
    assert (results["status"] == "ok").mean() > 0.9
    # The straight line ends some decimetres beside the bent one.
    np.testing.assert_allclose(results["h_g_m"], given["h_g_m"], atol=1.0)


def test_heights_relative_to_home_are_refused(mission, modelled):
    modelled(reference="relative")
    ended = mission.run()
    assert (ended.code, "heights of a dem" in ended.err) == (2, True), ended.text


@pytest.mark.parametrize("add_m", [0.0, 60.0])
def test_a_model_of_another_datum_is_found_at_the_take_off(mission, modelled, monkeypatch, add_m):
    """The field lies in a wider model; 60 m are more than a model and a receiver leave."""
    monkeypatch.setitem(globals(), "STEP_M", 40.0)
    modelled(change=lambda z: z + add_m)
    manifest = check_mission(mission.save()).manifest.values
    found = [e for e in manifest["ledger"] if e["code"] == "PLAUSIBLE-TERRAIN"]
    assert len(found) == (add_m > 0.0)
    for each in found:
        assert each["kind"] == "finding"
        assert "is 510 m above sea level" in each["what"]
        assert "by the elevation model where the log begins" in each["what"]
        assert "ground.height" in each["where"]
