"""Heights of an adjusted block with five heads, before and after the correction."""

from functools import cache

import numpy as np
from matplotlib.figure import Figure

from tests.golden import adjusted_block as blocks

SIZE = (8.2, 4.8)
# Barrow, 2010-06-01
AIR = 4
SEED = 5
HEIGHT_M = 6000.0
KINDS = ("", ", self-calibration")
NAMES = tuple(f"{name}{kind}" for kind in KINDS for name in ("uncorrected", "corrected"))


@cache
def block() -> tuple[blocks.Block, np.ndarray]:
    """The block, and its corrected pixels."""
    air = blocks.real_airs()[AIR]
    flown = blocks.fly_block(air, HEIGHT_M, SEED, blocks.heads(), lines=7, shots=11, most=16)
    profile = air.adjusted_profile(HEIGHT_M, np.random.default_rng(SEED))
    return flown, blocks.correct(flown, profile)


@cache
def adjusted(name: str) -> blocks.Adjusted:
    flown, corrected = block()
    pixels = flown.measured if name.startswith("uncorrected") else corrected
    return blocks.adjust(flown, pixels, gnss=True, calibrate="calibration" in name)


def rows(names: tuple[str, ...] = NAMES) -> list[list[str]]:
    found = [["height error [m]", "RMS", "mean", "smallest", "largest", "horizontal RMS"]]
    for name in names:
        east_north_up = adjusted(name).error
        up = east_north_up[:, 2]
        plane = np.sqrt(np.mean(east_north_up[:, :2] ** 2))
        numbers = (adjusted(name).z, up.mean(), up.min(), up.max(), plane)
        found.append([name, *(f"{value:.4f}" for value in numbers)])
    return found


def draw(figure: Figure, table: list[list[str]]) -> None:
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    for axis, name in zip(axes, NAMES[:2], strict=True):
        error = adjusted(name).error
        flown = block()[0]
        places = flown.local(flown.points.ecef_m)[np.unique(flown.seen.point), :2] / 1000.0
        shown = axis.scatter(*places.T, c=error[:, 2], s=14, cmap="coolwarm", vmin=-0.5, vmax=0.5)
        axis.set_title(f"{name}: {1000 * adjusted(name).z:.1f} mm RMS")
        axis.set_xlabel("east [km]")
        axis.set_aspect("equal")
    axes[0].set_ylabel("north [km]")
    figure.colorbar(shown, ax=axes, label="height error of points [m]", shrink=0.9)
