"""The air of the sample flight, and what it does to its oblique images; after `make sample`."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from docs.gallery.plates import BLUE, GREEN, GREY, ORANGE

SIZE = (8.2, 3.8)
RESULTS = Path(__file__).resolve().parents[2] / "results" / "sample_bin"
HEIGHTS_M = (500, 1000, 1500, 2000, 2500, 3000, 3450)
TEMPERATURES = ["temperature_k", "standard_temperature_k"]
CAMERA = "oblique"
WIDTH_PX = 14_000
HEIGHT_PX = 10_600
COLUMNS = 10  # of arrows
LINES = 8  # of arrows


def curves(results: Path) -> pd.DataFrame:
    """Temperatures [°C] and sigma of the flight's air against height."""
    profile = pd.read_parquet(results / "profile.parquet")
    profile = profile.query("200 < h_m < 4200")
    celsius = profile[TEMPERATURES] - 273.15
    return celsius.join(profile[["h_m", "sigma_temperature_k", "source"]])


def rows(results: Path = RESULTS) -> list[list[str]]:
    table = [["height [m]", "the flight's air [°C]", "US 1976 [°C]", "sigma [K]"]]
    air = curves(results)
    for height in HEIGHTS_M:
        row = [str(height)]
        for column in (*TEMPERATURES, "sigma_temperature_k"):
            value = np.interp(height, air["h_m"], air[column])
            row.append(f"{value:.1f}")
        table.append(row)
    return table


def draw(figure: Figure, table: list[list[str]]) -> None:
    left, right = figure.subplots(1, 2, width_ratios=(2, 3))
    draw_air(left)
    draw_arrows(right)


def draw_air(axis: Axes) -> None:
    air = curves(RESULTS)
    height = air["h_m"]
    temperature = air["temperature_k"]
    is_measured = air["source"] == "measured"
    measured = temperature.where(is_measured)
    axis.plot(air["standard_temperature_k"], height, color=GREY, label="US 1976")
    axis.plot(temperature, height, color=ORANGE, lw=1, label="not measured: climatology")
    axis.plot(measured, height, color=GREEN, lw=2.5, label="measured in flight")
    axis.set_xlabel("temperature [°C]")
    axis.set_ylabel("height above sea level [m]")
    axis.legend(fontsize=8)


def draw_arrows(axis: Axes) -> None:
    points = pd.read_parquet(RESULTS / "observations").query("status == 'ok'")
    points = points[points["image"].str.startswith(CAMERA)]
    x = points["x_px"]
    y = points["y_px"]
    points["shift_x"] = points["x_corrected_px"] - x
    points["shift_y"] = points["y_corrected_px"] - y
    cell = [x * COLUMNS // WIDTH_PX, y * LINES // HEIGHT_PX]
    means = points.groupby(cell)[["x_px", "y_px", "shift_x", "shift_y"]].mean()
    arrows = axis.quiver(
        *means.to_numpy().T,
        angles="xy",
        color=BLUE,
        width=0.004,
        scale=12.0,
    )
    legend = "1 px, measured to corrected"
    axis.quiverkey(
        arrows,
        0.8,
        1.05,
        1.0,
        legend,
        labelpos="W",
        color=BLUE,
    )
    axis.set(xlim=(0, WIDTH_PX), ylim=(HEIGHT_PX, 0), aspect="equal")
    axis.set(xlabel="x [px]", ylabel="y [px]")
