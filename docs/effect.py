"""Draws docs/effect.png, the picture in the README, from the sample mission.

Run it after `make sample`:  .venv/bin/python docs/effect.py
"""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.atmosphere.air_samples import AirSamples
from pipeline.config import load_mission
from pipeline.refraction.effect import FlightAir
from pipeline.refraction.statistics import ShiftGrid
from pipeline.report.figures import (
    ADJUSTED,
    MEASURED,
    STANDARD,
    new_figure,
    save_figure,
    styled,
)
from pipeline.report.flown import air_curves
from pipeline.stages.story import read_mission

REPOSITORY = Path(__file__).resolve().parents[1]
CAMERA = "oblique"


@styled
def effect_figure(air: FlightAir, samples: AirSamples, camera: str, grid: ShiftGrid) -> Figure:
    """The air of a flight beside what it does to the images of one camera."""
    figure, (left, right) = new_figure(2, 8.2, 3.4)
    draw_temperature(left, air, samples)
    left.set_title("the air: measured against standard", fontsize=9)
    draw_shifts(figure, right, grid)
    right.set_title(f"what it does to the {camera} image", fontsize=9)
    return figure


def draw_temperature(axis: Axes, air: FlightAir, samples: AirSamples) -> None:
    """The temperature of the air and of the standard, and the samples."""
    curves = air_curves(air, samples, np.empty(0))
    for sensor in (s for s in curves["samples"] if s["column"] == 0):
        axis.plot(sensor["values_used"], sensor["h_used"], ".", ms=1.6, alpha=0.5, color=MEASURED,
                  label=f"{sensor['sensor']}, used")  # fmt: skip
    axis.plot(curves["standard"][0], curves["h_m"], color=STANDARD, lw=1.2,
              label=curves["standard_name"])  # fmt: skip
    if curves["ours"] is not None:
        axis.plot(curves["ours"][0], curves["h_m"], color=ADJUSTED, lw=1.4,
                  label=air.adjustment.profile.name)  # fmt: skip
    axis.set_xlabel("temperature [°C]")
    axis.set_ylabel("height above sea level [m]")
    axis.legend(frameon=False, markerscale=4.0)


def draw_shifts(figure: Figure, axis: Axes, grid: ShiftGrid) -> None:
    """The mean shifts of a grid as arrows over its image."""
    axis.set_xlim(0, grid.width_px)
    axis.set_ylim(grid.height_px, 0)
    axis.set_aspect("equal")
    axis.locator_params(axis="x", nbins=5)
    axis.set_xlabel("x [px]")
    axis.set_ylabel("y [px]")
    x, y, dx, dy = grid.means()
    size = np.hypot(dx, dy)
    # The longest arrow spans 0.9 of a cell of the grid.
    scale = 0.9 * grid.width_px / grid.columns / float(size.max())
    arrows = axis.quiver(
        x, y, dx * scale, dy * scale, size, angles="xy", scale_units="xy",
        scale=1.0, width=0.005, cmap="viridis",
    )  # fmt: skip
    figure.colorbar(arrows, ax=axis, label="shift [px]", shrink=0.8)


def main() -> None:
    config = REPOSITORY / "configs" / "sample_bin.yaml"
    mission = load_mission(config)
    prepared = read_mission(config)
    air, samples = prepared.air, prepared.samples
    camera = mission.cameras[CAMERA]
    grid = ShiftGrid(camera.width_px, camera.height_px)
    for part in sorted((REPOSITORY / "results" / "sample_bin").glob("observations/part-*.parquet")):
        rows = pq.read_table(part).to_pandas()
        rows = rows[rows["image"].str.startswith(CAMERA) & (rows["status"] == "ok")]
        x, y = rows["x_px"].to_numpy(), rows["y_px"].to_numpy()
        grid.add(x, y, rows["x_corrected_px"].to_numpy() - x, rows["y_corrected_px"].to_numpy() - y)
    if not np.any(grid.sums[2]):
        raise SystemExit("no results in results/sample_bin: run `make sample` first")
    save_figure(effect_figure(air, samples, CAMERA, grid), REPOSITORY / "docs" / "effect.png")


if __name__ == "__main__":
    main()
