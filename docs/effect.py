"""Draws docs/effect.png, the picture in the README, from the sample mission.

Run it after `make sample`:  .venv/bin/python docs/effect.py
"""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from pipeline.config import load_mission
from pipeline.refraction.spread import ImageGrid
from pipeline.report.figures import effect_figure, save_figure
from pipeline.stages import air_of_mission

REPOSITORY = Path(__file__).resolve().parents[1]
CAMERA = "oblique"


def main() -> None:
    config = REPOSITORY / "configs" / "sample_bin.yaml"
    mission = load_mission(config)
    air, samples, _ = air_of_mission(config)
    camera = mission.cameras[CAMERA]
    grid = ImageGrid(camera.width_px, camera.height_px)
    for part in sorted((REPOSITORY / "results" / "sample_bin").glob("observations/part-*.parquet")):
        rows = pq.read_table(part).to_pandas()
        rows = rows[rows["image"].str.startswith(CAMERA) & (rows["status"] == "ok")]
        x, y = rows["x_px"].to_numpy(), rows["y_px"].to_numpy()
        grid.add(x, y, rows["x_corrected_px"].to_numpy() - x, rows["y_corrected_px"].to_numpy() - y)
    if not np.any(grid.sums[2]):
        raise SystemExit("no results in results/sample_bin: run `make sample` first")
    save_figure(
        effect_figure(air.adjustment, samples, CAMERA, grid), REPOSITORY / "docs" / "effect.png"
    )


if __name__ == "__main__":
    main()
