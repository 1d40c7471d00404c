"""A million rays to an elevation model of a hundred million cells, beside given heights."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from survey import exposures, write_observations
from table_correction import correct_table

from unbend.stages.ground_heights import GivenGround, TerrainGround
from unbend.tables.geodata.elevation import open_elevation

IMAGES = 200
LINES = 10
ROWS = 1_000_000
CELLS = 10_000
STEP_DEG = 1.0 / 10_800.0  # 10 m


def write_model(path: Path):
    """Hills of 300 m, and of 30 m on them, as a tiled and compressed GeoTIFF."""
    import rasterio

    north = np.degrees(0.805) + CELLS / 2 * STEP_DEG
    west = -CELLS / 2 * STEP_DEG
    column = np.arange(CELLS, dtype=np.float32)
    row = column[:, None]
    hills = 300.0 * np.sin(column / 700.0) * np.cos(row / 500.0)
    small_hills = 30.0 * np.sin(column / 40.0) * np.sin(row / 55.0)
    z = 500.0 + hills + small_hills
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=CELLS,
        height=CELLS,
        count=1,
        dtype="float32",
        crs="EPSG:4326",
        transform=rasterio.Affine(STEP_DEG, 0, west, 0, -STEP_DEG, north),
        tiled=True,
        blockxsize=512,
        blockysize=512,
        compress="deflate",
        predictor=3,
    ) as out:
        out.write(z.astype(np.float32), 1)


def flown_places() -> tuple[np.ndarray, np.ndarray]:
    """Latitude and longitude [rad] along ten lines to and fro over nearly all of the model."""
    each = IMAGES // LINES
    north = np.linspace(-0.006, 0.006, LINES)
    to = np.linspace(-0.007, 0.007, each)
    fro = to[::-1]
    longitude = np.tile(np.append(to, fro), LINES // 2)
    return 0.805 + np.repeat(north, each), longitude


def correct(source: Path, out: Path, model: Path | None):
    """Correct a million observations, from a file to a file, with sigmas."""
    places = flown_places()
    flown = replace(exposures(IMAGES), latitude_rad=places[0])
    if model is None:
        given = GivenGround(None, np.zeros(IMAGES), sigma_m=2.0)
        status = correct_table(source, out, flown, given, "h_g_m")
    else:
        elevation, _ = open_elevation([model], None, reference="msl", undulation=np.zeros_like)
        terrain = TerrainGround(elevation, places, sigma_m=2.0)
        status = correct_table(source, out, flown, terrain, None)
    assert status["ok"] == ROWS, status


def test_a_million_rays_to_a_model_beside_given_heights(ratios, tmp_path):
    source = tmp_path / "observations.parquet"
    model = tmp_path / "dem.tif"
    write_observations(source, ROWS, IMAGES)
    write_model(model)
    ratio = ratios.of_times(
        lambda: correct(source, tmp_path / "given", None),
        lambda: correct(source, tmp_path / "terrain", model),
        rounds=3,
    )
    ratios.check("a million rays to a model, times given heights", ratio, at_most=5.0)
    command = [sys.executable, __file__, str(source), str(tmp_path / "peak"), str(model)]
    peak = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parent,
    )
    peak_gb = float(peak.stdout) * 1024 / 1e9
    ratios.check("memory with a model of 400 MB [GB]", peak_gb, at_most=1.0)


if __name__ == "__main__":
    correct(Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]))
    # Not ru_maxrss: that starts at what the parent had when it made this process.
    status = Path("/proc/self/status").read_text()
    print(status.partition("VmHWM:")[2].split()[0])
