"""Ground heights from an elevation model; truth are the simulator's points on its terrain."""

import json
import sys

import numpy as np
import pandas as pd
import pytest
import rasterio
from numpy.testing import assert_allclose
from rasterio import Affine

from tests.helpers import codes_of, entry_of
from tests.stages.terrain_models import CELLS, terrain_grid
from tests.tables.geodata.rasters import write_raster
from unbend.batch.runs import figure_data_of

STEP_M = 20.0
WIDE_STEP_M = 80.0  # of a model in which the field lies as well
HOLE = -32768.0


def moved(cells, columns):
    """Cells that begin some columns further east."""
    west = cells.c + columns * cells.a
    return Affine(cells.a, cells.b, west, cells.d, cells.e, cells.f)


@pytest.fixture
def modelled(mission, flown):
    """Writes elevation models of the simulator's terrain, and sets the mission to use them."""
    points = pd.read_parquet(flown.truth / "points.parquet")
    middle = points[["lon_deg", "lat_deg"]].mean()

    def write(
        change=lambda z: z,
        *,
        grid="EPSG:4326",
        columns=slice(0, CELLS),
        name="dem.tif",
        step_m=STEP_M,
        dtype="float32",
        **changed,
    ):
        terrain, transform = terrain_grid(grid, *middle, step_m)
        values = change(terrain)[:, columns].astype(dtype)
        options = {"crs": grid, "tiled": True} | changed
        cells = moved(transform, columns.start)
        write_raster(mission.folder / name, values, cells, **options)
        mission.config["ground"] = {"height": {"dem": name}, "reference": "msl"}

    return write


@pytest.fixture(scope="module")
def by_points(baseline):
    """Results by the true heights of the points."""
    return baseline.result_rows()


def set_models(mission, names):
    mission.config["ground"]["height"]["dem"] = names


def opened(mission, name="dem.tif"):
    """A raster of the mission, to be changed."""
    return rasterio.open(mission.folder / name, "r+")


def assert_heights(mission, by_points, tolerance_m=0.4):
    """Stations from the log are a metre or two off, and slopes are up to 1 in 10."""
    assert_allclose(mission.result_rows()["h_g_m"], by_points["h_g_m"], atol=tolerance_m)


@pytest.mark.parametrize("grid", ["EPSG:4326", "EPSG:25832", "EPSG:3035"])
def test_heights_and_corrections_are_those_of_the_points(mission, modelled, by_points, grid):
    modelled(grid=grid)
    mission.config["ground"]["sigma_m"] = 1.0
    manifest = mission.run_to_manifest()
    assert_heights(mission, by_points)
    results = mission.result_rows()
    for column in ("x_corrected_px", "y_corrected_px"):
        assert_allclose(results[column], by_points[column], atol=1e-4)
    assert (results["status"] == "ok").all()
    assert results["sigma_ground_dx_px"].notna().all()
    assert entry_of(manifest, "DEM-READ")["count"] == 1


def test_a_model_above_all_cameras_is_said_to_be_above_them(mission, modelled):
    modelled(lambda z: 0.0 * z + 8000.0)
    flagged = entry_of(mission.run_to_manifest(3), "OBS-FLAGGED")
    assert "the ground is above the camera (ground.height" in flagged["what"]


def test_tiles_in_any_order_are_one_model(mission, modelled, by_points):
    modelled(columns=slice(397, CELLS), name="tile0.tif")
    modelled(columns=slice(0, 401), name="tile1.tif")
    set_models(mission, ["tile0.tif", "tile1.tif"])
    manifest = mission.run_to_manifest()
    assert_heights(mission, by_points)
    assert "TIES-HEIGHT" not in codes_of(manifest)


def test_ellipsoidal_heights_are_reduced_by_the_undulation(mission, modelled, by_points):
    modelled(lambda z: z + 47.0)
    mission.config["mission"]["undulation_m"] = 47.0
    mission.config["ground"]["reference"] = "ellipsoid"
    mission.run_to_manifest()
    assert_heights(mission, by_points)


def test_heights_in_feet_that_say_so(mission, modelled, by_points):
    modelled(lambda z: z / 0.3048)
    with opened(mission) as raster:
        raster.units = ["ft"]
    manifest = mission.run_to_manifest()
    assert_heights(mission, by_points)
    assert "0.3048 m" in entry_of(manifest, "DEM-READ")["what"]


def test_scale_and_offset_of_the_band_are_applied(mission, modelled, by_points):
    modelled(lambda z: np.round((z - 300.0) / 0.05), dtype="int16")
    with opened(mission) as raster:
        raster.scales = (0.05,)
        raster.offsets = (300.0,)
    mission.run_to_manifest()
    assert_heights(mission, by_points, 0.45)


def east_half(value):
    """A change that gives the eastern half of a model one value."""
    is_east = np.arange(CELLS) >= CELLS // 2
    return lambda z: np.where(is_east, value, z)


CHANGES = {
    "a hillshade": lambda z: np.clip(z, 0, 255),
    "another zero": lambda z: z + 60.0,
    "zero in holes": east_half(0.0),
    "upside down": np.flipud,
    "east for west": np.fliplr,
    "axes exchanged": np.transpose,
    "four kilometres beside": lambda z: np.roll(z, CELLS // 4, axis=1),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_tie_points_contradict_a_model_of_other_heights(mission, modelled, change):
    modelled(change)
    manifest = mission.run_to_manifest(3)
    assert entry_of(manifest, "TIES-HEIGHT")["kind"] == "finding"
    assert "DEM-UNVERIFIED" not in codes_of(manifest)


def test_a_model_in_feet_is_too_far_from_the_take_off(mission, modelled):
    """What tie points find follows from it, and is held back."""
    modelled(lambda z: z / 0.3048)
    manifest = mission.run_to_manifest(3)
    ground = entry_of(manifest, "PLAUSIBLE-GROUND")
    assert ground["kind"] == "finding"
    assert "likely feet" in ground["what"]
    assert "TIES-HEIGHT" in entry_of(manifest, "TIES-HELD-BACK")["what"]


def observe_single_points(mission):
    """Let every point be in one image."""
    table = mission.measured_rows()
    table["point"] += table["image"]
    mission.observe_rows(table)


def checked(mission):
    """The manifest of a rehearsal."""
    return mission.checked().manifest.values


def kinds_of(mission):
    """What a rehearsal says that is more than a note: code -> kind."""
    ledger = checked(mission)["ledger"]
    return {entry["code"]: entry["kind"] for entry in ledger if entry["kind"] != "note"}


def test_a_model_that_nothing_can_verify_is_said_to_be_so(mission, modelled):
    """Upside down, and every point in one image: no check can see it, and the ledger says that."""
    modelled(np.flipud)
    observe_single_points(mission)
    kinds = kinds_of(mission)
    assert kinds["DEM-UNVERIFIED"] == "warning"
    assert "TIES-HEIGHT" not in kinds
    assert "finding" not in kinds.values()


@pytest.mark.parametrize("has_model", [True, False])
def test_a_model_that_the_take_off_verifies_or_none(mission, modelled, has_model):
    if has_model:
        modelled(step_m=WIDE_STEP_M)
    observe_single_points(mission)
    kinds = kinds_of(mission)
    assert not {"DEM-UNVERIFIED", "TIES-HEIGHT", "PLAUSIBLE-TERRAIN"} & set(kinds)
    assert "finding" not in kinds.values()


def test_the_map_has_the_relief_of_the_model(mission, modelled):
    modelled()
    flown = figure_data_of(mission.checked().corrected)
    limits_deg, light = flown.relief
    assert limits_deg == pytest.approx(flown.limits_deg, abs=3e-4)
    assert np.ptp(light[np.isfinite(light)]) > 0.1


def test_a_model_of_another_datum_is_found_at_the_take_off(mission, modelled):
    """60 m are more than a model and a receiver leave."""
    modelled(lambda z: z + 60.0, step_m=WIDE_STEP_M)
    terrain = entry_of(checked(mission), "PLAUSIBLE-TERRAIN")
    assert terrain["kind"] == "finding"
    assert "is 510 m above sea level" in terrain["what"]
    assert "by the elevation model where the log begins" in terrain["what"]
    assert "ground.height" in terrain["where"]


def test_a_hole_under_half_of_the_block_is_flagged_with_its_number(mission, modelled, by_points):
    modelled(east_half(HOLE))
    manifest = mission.run_to_manifest(3)
    results = mission.result_rows()
    missing = results["status"] == "no_ground"
    assert 0 < missing.sum() < missing.size
    assert results["x_corrected_px"][missing].isna().all()
    heights = results["h_g_m"][~missing]
    assert_allclose(heights, by_points["h_g_m"][~missing], atol=0.4)
    assert entry_of(manifest, "OBS-FLAGGED")["count"] == missing.sum()


def test_a_model_that_lies_elsewhere_or_under_half_of_the_block(mission, modelled):
    modelled(columns=slice(0, 20))
    assert "6 of 6 stations" in mission.refusal("DEM-OUTSIDE")
    modelled(columns=slice(0, CELLS // 2))
    loss = entry_of(mission.run_to_manifest(3), "DEM-OUTSIDE")
    with opened(mission) as raster:
        east_deg = raster.bounds.right
    is_beside = mission.station_rows()["lon_deg"] > east_deg
    assert 0 < is_beside.sum() < is_beside.size
    assert loss["kind"] == "loss"
    assert loss["count"] == is_beside.sum()
    assert "no_ground" in set(mission.result_rows()["status"])


def state_crs(mission, crs):
    mission.config["ground"]["height"]["crs"] = crs


def test_a_model_without_a_system_has_the_stated_one(mission, modelled, by_points):
    modelled(crs=None)
    assert "ground.height.crs" in mission.refusal("DEM-CRS")
    state_crs(mission, "EPSG:4326")
    mission.run_to_manifest()
    assert_heights(mission, by_points)


def test_a_stated_system_that_the_model_contradicts(mission, modelled):
    modelled()
    state_crs(mission, "EPSG:25832")
    assert "ETRS89 / UTM zone 32N is stated" in mission.refusal("DEM-CRS")


def test_a_system_with_ellipsoidal_heights(mission, modelled):
    modelled(crs="EPSG:4979")
    assert "ellipsoid" in mission.refusal("CRS-VERTICAL")


def test_the_next_zone(mission, modelled):
    modelled(grid="EPSG:25832", crs=None)
    state_crs(mission, "EPSG:25833")
    assert "6 of 6 stations" in mission.refusal("DEM-OUTSIDE")


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ({"grid": "EPSG:25832", "crs": "EPSG:25832+7837"}, "DHHN2016"),
        # DHDN: BETA2007, or Helmert to some metres.
        ({"grid": "EPSG:31467"}, "needs de_adv_BETA2007.tif"),
    ],
    ids=["vertical datum", "missing grid"],
)
def test_what_a_system_leaves_open_is_a_warning(mission, modelled, written, words):
    modelled(**written)
    message = entry_of(mission.run_to_manifest(), "DEM-READ")
    assert message["kind"] == "warning"
    assert words in message["what"]


SERVICE = """<GDAL_WMS><Service name="TMS"><ServerUrl>http://127.0.0.1:9/${z}/${x}/${y}.tif</ServerUrl>
</Service><DataWindow><UpperLeftX>-180</UpperLeftX><UpperLeftY>90</UpperLeftY><LowerRightX>180
</LowerRightX><LowerRightY>-90</LowerRightY><TileLevel>3</TileLevel></DataWindow>
<Projection>EPSG:4326</Projection><BandsCount>1</BandsCount><DataType>Float32</DataType></GDAL_WMS>"""


def index_of(raster):
    """An index of tiles that names one raster, which lies about the block."""
    ring = [[8.0, 48.0], [9.0, 48.0], [9.0, 49.0], [8.0, 49.0], [8.0, 48.0]]
    tile = {
        "type": "Feature",
        "properties": {"location": str(raster)},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
    collection = {"type": "FeatureCollection", "features": [tile]}
    tiles = raster.with_name("tiles.geojson")
    tiles.write_text(json.dumps(collection))
    return f"<GDALTileIndexDataset><IndexDataset>{tiles}</IndexDataset></GDALTileIndexDataset>"


def test_a_raster_of_no_heights_is_refused(mission, modelled):
    modelled()
    with opened(mission) as raster:
        raster.units = ["K"]
    assert "'K'" in mission.refusal("DEM-UNIT")
    with opened(mission) as raster:
        raster.units = ["m"]
        raster.transform = Affine(1e-4, 1e-5, 8.0, 0.0, -1e-4, 49.0)
    mission.refusal("DEM-RASTER")
    dem = mission.folder / "dem.tif"
    dem.write_bytes(b"no raster")
    mission.refusal("DEM-UNREADABLE")
    dem.unlink()
    assert "ground.height.dem" in mission.refusal("INPUT-MISSING")


def test_files_that_name_others_are_refused(mission, modelled):
    """An index of tiles and a service: nobody would see a change of the others."""
    modelled()
    set_models(mission, "dem.gti")
    index = index_of(mission.folder / "dem.tif")
    for text in (index, SERVICE):
        (mission.folder / "dem.gti").write_text(text)
        assert "name the rasters" in mission.refusal("DEM-RASTER")


def test_rasters_beside_one_grid_are_refused(mission, modelled):
    modelled(name="a.tif")
    modelled(name="b.tif")
    with opened(mission, "b.tif") as raster:
        raster.transform = moved(raster.transform, 0.5)
    set_models(mission, ["a.tif", "b.tif"])
    assert "0.5 cells" in mission.refusal("DEM-TILES")


def test_without_rasterio_it_says_what_to_install(mission, modelled, monkeypatch):
    modelled()
    monkeypatch.setitem(sys.modules, "rasterio", None)
    assert "unbend[rasters]" in mission.refusal("DEM-RASTERIO")


def test_ideal_observations_are_displaced_by_the_same_ground(mission, modelled, by_points):
    modelled()
    mission.config["refraction"] = {"direction": "apply"}
    mission.run_to_manifest(3)  # PLAUSIBLE-APPLY: these were measured
    is_ok = mission.result_rows()["status"] == "ok"
    assert is_ok.mean() > 0.9
    # The straight line ends some decimetres beside the bent one.
    assert_heights(mission, by_points, 1.0)
