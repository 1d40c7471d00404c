"""A million rays to an elevation model of a hundred million cells, beside given heights."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from survey import CAMERA, air, exposures, image_names, uncertainty, write_observations

from unbend.batch.run_files import PartsOfRun, correct_into
from unbend.batch.store import open_folder
from unbend.messages import Ledger
from unbend.refraction.ray import rays_by
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.ground_heights import GivenGround, TerrainGround
from unbend.tables.geodata.elevation import open_elevation
from unbend.tables.manifest.whole import Manifest
from unbend.tables.observations import open_observations

IMAGES = 200
ROWS = 1_000_000
CELLS = 10_000
STEP_DEG = 1.0 / 10_800.0  # 10 m
COLUMNS = {"image": "image", "point": "point", "x_px": "x_px", "y_px": "y_px"}


def write_model(path: Path) -> None:
    """Hills of 300 m, and of 30 m on them, as a tiled and compressed GeoTIFF."""
    import rasterio

    north = np.degrees(0.805) + CELLS / 2 * STEP_DEG
    west = -CELLS / 2 * STEP_DEG
    row = np.arange(CELLS, dtype=np.float32)[:, None]
    column = np.arange(CELLS, dtype=np.float32)
    z = 500.0 + 300.0 * np.sin(column / 700.0) * np.cos(row / 500.0)
    z += 30.0 * np.sin(column / 40.0) * np.sin(row / 55.0)
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
    lines = 10
    each = IMAGES // 10
    along = np.linspace(-0.007, 0.007, each)
    lon = np.concatenate([along if line % 2 == 0 else along[::-1] for line in range(lines)])
    return 0.805 + np.repeat(np.linspace(-0.006, 0.006, lines), each), lon


def correct(source: Path, out: Path, model: Path | None) -> None:
    """Correct a million observations, from a file to a file, with sigmas."""
    lat, lon = flown_places()
    seen_from = replace(exposures(IMAGES), latitude_rad=lat)
    ground: GivenGround | TerrainGround = GivenGround(None, np.zeros(IMAGES), sigma_m=2.0)
    if model is not None:
        elevation, _ = open_elevation([model], None, reference="msl", undulation=np.zeros_like)
        ground = TerrainGround(elevation, (lat, lon), 2.0)
    setup = CorrectionSetup(
        image_names(IMAGES),
        np.full(IMAGES, "nadir", object),
        seen_from,
        ground,
        {"nadir": CAMERA},
        (rays_by(air(), "spherical"),),
        np.zeros(IMAGES, np.int64),
        uncertainties=(uncertainty(seen_from),),
    )
    column = "h_g_m" if model is None else None
    observations = open_observations(source, COLUMNS, column, Ledger())
    with open_folder(out) as folder:
        statistics = correct_into(
            PartsOfRun(folder), observations, setup, batch_rows=250_000, metadata={}
        )
        outputs = [asdict(output) for output in folder.outputs()]
        folder.commit(Manifest({"outputs": outputs}))
    assert statistics.status["ok"] == ROWS, statistics.status


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
    peak = subprocess.run(
        [sys.executable, __file__, str(source), str(tmp_path / "peak"), str(model)],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parent,
    )
    ratios.check("memory with a model of 400 MB [GB]", float(peak.stdout) * 1024 / 1e9, at_most=1.0)


if __name__ == "__main__":
    correct(Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]))
    # Not ru_maxrss: that starts at what the parent had when it made this process.
    print(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
