"""Heights of an adjusted block with five heads, before and after the correction."""

from functools import cache

import numpy as np
from matplotlib.figure import Figure

from tests.golden.adjusted_block import (
    Adjusted,
    Block,
    adjust,
    correct,
    fly_block,
    heads,
    real_airs,
)

SIZE = (8.2, 4.8)
AIR = 4  # Barrow, 2010-06-01
SEED = 5
HEIGHT_M = 6000.0
NAMES = (
    "uncorrected",
    "corrected",
    "uncorrected, self-calibration",
    "corrected, self-calibration",
)


@cache
def block() -> tuple[Block, np.ndarray]:
    """The block, and its corrected pixels."""
    air = real_airs()[AIR]
    flown = fly_block(air, HEIGHT_M, SEED, heads(), lines=7, shots=11, most=16)
    profile = air.adjusted_profile(HEIGHT_M, np.random.default_rng(SEED))
    return flown, correct(flown, profile)


@cache
def adjusted(name: str) -> Adjusted:
    flown, pixels = block()
    if name.startswith("uncorrected"):
        pixels = flown.measured
    calibrate = name.endswith("self-calibration")
    return adjust(flown, pixels, gnss=True, calibrate=calibrate)


def rows(names: tuple[str, ...] = NAMES) -> list[list[str]]:
    table = [["height error [m]", "RMS", "mean", "smallest", "largest", "horizontal RMS"]]
    for name in names:
        error = adjusted(name).error
        up = error[:, 2]
        horizontal_rms = np.sqrt(np.mean(error[:, :2] ** 2))
        numbers = (adjusted(name).z, up.mean(), up.min(), up.max(), horizontal_rms)
        table.append([name, *(f"{value:.4f}" for value in numbers)])
    return table


def draw(figure: Figure, table: list[list[str]]) -> None:
    flown, _ = block()
    seen = np.unique(flown.seen.point)
    local_m = flown.local(flown.points.ecef_m)[seen]
    east_km, north_km = local_m[:, :2].T / 1000.0
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    for axis, name in zip(axes, NAMES[:2], strict=True):
        shown = axis.scatter(
            east_km,
            north_km,
            c=adjusted(name).error[:, 2],
            s=14,
            cmap="coolwarm",
            vmin=-0.5,
            vmax=0.5,
        )
        axis.set_title(f"{name}: {1000 * adjusted(name).z:.1f} mm RMS")
        axis.set_xlabel("east [km]")
        axis.set_aspect("equal")
    axes[0].set_ylabel("north [km]")
    figure.colorbar(
        shown,
        ax=axes,
        label="height error of points [m]",
        shrink=0.9,
    )
