"""Draws docs/effect.png, the picture in the README, from the sample mission.

Run it after `make sample`:  .venv/bin/python docs/effect.py
"""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.atmosphere.air_samples import AirSamples
from pipeline.atmosphere.estimate.adjusted_profile import Adjustment
from pipeline.config import load_mission
from pipeline.refraction.statistics import ShiftGrid
from pipeline.report.figures import (
    ADJUSTED,
    STANDARD,
    draw_shifts,
    height_range,
    new_figure,
    save_figure,
    scatter,
    styled,
)
from pipeline.stages.story import read_mission
from pipeline.units import ZERO_CELSIUS_K

REPOSITORY = Path(__file__).resolve().parents[1]
CAMERA = "oblique"


@styled
def effect_figure(
    adjustment: Adjustment, samples: AirSamples, camera: str, grid: ShiftGrid
) -> Figure:
    """The air of a flight beside what it does to the images of one camera."""
    figure, (left, right) = new_figure(2, 8.2, 3.4)
    _draw_temperature(left, adjustment, samples)
    left.set_title("the air: measured against standard", fontsize=9)
    draw_shifts(figure, right, grid)
    right.set_title(f"what it does to the {camera} image", fontsize=9)
    return figure


def _draw_temperature(axis: Axes, adjustment: Adjustment, samples: AirSamples) -> None:
    profile, standard = adjustment.profile, adjustment.standard
    h = np.linspace(*height_range(samples), 400)
    if samples.temperature is not None:
        scatter(axis, samples.temperature, samples.temperature.value - ZERO_CELSIUS_K)
    axis.plot(standard.temperature(h) - ZERO_CELSIUS_K, h, color=STANDARD, lw=1.2,
              label=standard.name)  # fmt: skip
    if profile is not standard:
        t = profile.temperature(h) - ZERO_CELSIUS_K
        axis.plot(t, h, color=ADJUSTED, lw=1.4, label=profile.name)
    axis.set_xlabel("temperature [°C]")
    axis.set_ylabel("height above sea level [m]")
    axis.legend(frameon=False, markerscale=4.0)


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
    save_figure(
        effect_figure(air.adjustment, samples, CAMERA, grid), REPOSITORY / "docs" / "effect.png"
    )


if __name__ == "__main__":
    main()
