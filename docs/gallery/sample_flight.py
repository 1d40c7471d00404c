"""The air of the sample flight, and what it does to its oblique images; after `make sample`."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from docs.gallery.plates import BLUE, GREEN, GREY, ORANGE

SIZE = (8.2, 3.8)
RESULTS = Path(__file__).resolve().parents[2] / "results" / "sample_bin"
HEIGHTS_M = (500, 1000, 1500, 2000, 2500, 3000, 3450)
CAMERA = "oblique"
SIZE_PX = (14_000, 10_600)
CELLS = (10, 8)


def curves(results: Path) -> pd.DataFrame:
    """Temperatures [°C] and sigma of the flight's air against height."""
    profile = pd.read_parquet(results / "profile.parquet").query("200 < h_m < 4200")
    kelvin = profile[["temperature_k", "standard_temperature_k"]] - 273.15
    return kelvin.join(profile[["h_m", "sigma_temperature_k", "source"]])


def rows(results: Path = RESULTS) -> list[list[str]]:
    found = [["height [m]", "the flight's air [°C]", "US 1976 [°C]", "sigma [K]"]]
    air = curves(results)
    for h in HEIGHTS_M:
        columns = ("temperature_k", "standard_temperature_k", "sigma_temperature_k")
        values = (np.interp(h, air["h_m"], air[column]) for column in columns)
        found.append([str(h), *(f"{value:.1f}" for value in values)])
    return found


def draw(figure: Figure, table: list[list[str]]) -> None:
    left, right = figure.subplots(1, 2, width_ratios=(2, 3))
    air = curves(RESULTS)
    measured = air["temperature_k"].where(air["source"] == "measured")
    left.plot(air["standard_temperature_k"], air["h_m"], color=GREY, label="US 1976")
    left.plot(
        air["temperature_k"], air["h_m"], color=ORANGE, lw=1, label="not measured: climatology"
    )
    left.plot(measured, air["h_m"], color=GREEN, lw=2.5, label="measured in flight")
    left.set_xlabel("temperature [°C]")
    left.set_ylabel("height above sea level [m]")
    left.legend(fontsize=8)

    seen = pd.read_parquet(RESULTS / "observations").query("status == 'ok'")
    seen = seen[seen["image"].str.startswith(CAMERA)]
    x = seen["x_px"]
    y = seen["y_px"]
    seen = seen.assign(u=seen["x_corrected_px"] - x, v=seen["y_corrected_px"] - y)
    cell = [(a * n // size) for a, n, size in zip((x, y), CELLS, SIZE_PX, strict=True)]
    means = seen.groupby(cell)[["x_px", "y_px", "u", "v"]].mean()
    arrows = right.quiver(*means.to_numpy().T, angles="xy", color=BLUE, width=0.004, scale=12.0)
    right.quiverkey(arrows, 0.8, 1.05, 1.0, "1 px, measured to corrected", labelpos="W", color=BLUE)
    right.set(
        xlim=(0, SIZE_PX[0]), ylim=(SIZE_PX[1], 0), aspect="equal", xlabel="x [px]", ylabel="y [px]"
    )
