"""Writes docs/when.md: who needs a correction of refraction, and who does not, in metres.

Run it in the root of the repository:  .venv/bin/python -m docs.when

Blocks of simulated images in the air of nine real soundings, rays by the simulator's ODE, adjusted
by pycolmap: `tests/golden/adjusted_block.py`. Takes one minute.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.golden.adjusted_block import (
    US1976,
    Adjusted,
    Block,
    RealAir,
    adjust,
    correct,
    fly_block,
    heads,
    real_airs,
)

DOCUMENT = Path(__file__).with_name("when.md")
HEIGHT = 6000.0

CASES = {
    "nadir held": "nadir, orientations fixed",
    "nadir less mean": "the same, without its mean",
    "nadir control": "nadir, 9 control points",
    "nadir control calibrated": "nadir, 9 control points, self-calibration",
    "nadir gnss": "nadir, GNSS",
    "nadir gnss calibrated": "nadir, GNSS, self-calibration",
    "nadir both": "nadir, 9 control points, GNSS",
    "nadir both calibrated": "nadir, 9 control points, GNSS, self-calibration",
    "heads held": "five heads, orientations fixed",
    "heads control": "five heads, 9 control points",
    "heads control calibrated": "five heads, 9 control points, self-calibration",
    "heads gnss": "five heads, GNSS",
    "heads gnss calibrated": "five heads, GNSS, self-calibration",
    "heads both": "five heads, 9 control points, GNSS",
    "heads both calibrated": "five heads, 9 control points, GNSS, self-calibration",
    "carried": "nadir fixed, calibrated in flight at 3 km without correction, used at 6 km",
    "calibrated here": "nadir fixed, calibrated in flight at 6 km without correction",
}
"""What is adjusted, and what the document calls it."""

AIRS = {
    f"{air} {height}": f"{what}, {height} km"
    for height in (3, 6, 9)
    for air, what in (
        ("without", "uncorrected [m]"),
        ("standard", "left by US 1976 [%]"),
        ("adjusted", "left by the adjusted air [%]"),
    )
}
"""Height error of nadir blocks with orientations fixed, and what two airs leave of it."""

INTRODUCTION = """\
# Who needs a correction of refraction

Written by `python -m docs.when`. Do not edit this page.

The table compares simulated blocks with known truth:

* 6 km above ground, f = 20,000 px, 60 and 30 % overlap, 300 points 0 to 300 m high;
* 20 nadir images, or five heads (nadir and four at 45°) that see the points from all sides;
* rays from an ODE through nine atmospheres from real soundings;
* adjusted with pycolmap;
* no error except refraction: no noise, true positions.

The adjustments differ:

* *Fixed*: only points are adjusted.
* *GNSS*: positions are priors of 3 and 5 cm against 0.3 px, attitudes are free.
* *Control*: nine points are fixed at their true places.
* *Self-calibration*: f, k1, k2 of each camera are unknown.

Errors are root mean squares of the heights of all points except the control points. *Corrected*
uses the air that `unbend` determines from the flight's own sensors. These are biased, lag and
drift.
"""
OTHER_BLOCKS = """
Another layout of a block gives other numbers, and real adjustments have other errors too. At 120 m
above ground, refraction is 0.3 arcsec at a nadir angle of 45°: in the middle of an oblique image
0.006 px with f = 4,000 px, and 0.03 px with f = 20,000 px.

The simulated lens is not affected by the air in it. A real lens is: Meier computed for one of 153
mm, calibrated in a laboratory, that its principal distance is wrong at 6 km by 130 ppm behind a
pressurised window and by up to 310 ppm in the outside air. That is 0.8 to 1.9 m of height if
nothing absorbs it, more than the refraction in this table. Other lenses differ, and a sealed lens
may have none. `unbend` removes it if the mission file states
[the air of the calibration](pages/guide/lens.md). Self-calibration and control absorb it too.
"""
TWICE = """
In the last two rows the calibration was estimated from uncorrected images (control, GNSS), so it
contains refraction. Corrected images then have it twice.
"""

Numbers = dict[str, float]


def column(air: RealAir, seed: int) -> tuple[Numbers, Numbers, Numbers]:
    """Height errors [m] uncorrected and corrected with the adjusted air, and what airs leave.

    Root mean squares over the points that are no control, 6 km above ground.
    """
    rng = np.random.default_rng(seed)
    nadir = {h: fly_block(air, 1000.0 * h, seed, heads()[:1]) for h in (3, 6, 9)}
    adjusted = {h: air.adjusted_profile(1000.0 * h, rng) for h in nadir}
    airs: Numbers = {}
    for h, block in nadir.items():
        z = {
            "without": adjust(block, block.measured).z,
            "standard": adjust(block, correct(block, US1976)).z,
            "adjusted": adjust(block, correct(block, adjusted[h])).z,
        }
        airs[f"without {h}"] = z["without"]
        for name in ("standard", "adjusted"):
            airs[f"{name} {h}"] = 100.0 * z[name] / z["without"]

    five = fly_block(air, HEIGHT, seed, heads(), lines=7, shots=11, most=16)
    before = heights(nadir[6], five, nadir[6].measured, five.measured)
    after = heights(nadir[6], five, correct(nadir[6], adjusted[6]), correct(five, adjusted[6]))
    # The calibrations were estimated on uncorrected images, whatever is done with the images after.
    low = nadir[3]
    for name, block in (("carried", low), ("calibrated here", nadir[6])):
        interior = adjust(block, block.measured, control=9, gnss=True, calibrate=True).interior
        before[name] = adjust(nadir[6], nadir[6].measured, interior=interior).z
        after[name] = adjust(nadir[6], correct(nadir[6], adjusted[6]), interior=interior).z
    return before, after, airs


def heights(nadir: Block, five: Block, nadir_px: np.ndarray, five_px: np.ndarray) -> Numbers:
    """Height errors [m] of the cases in which images and their calibration belong together."""
    z: Numbers = {}
    for name, block, pixels in (("nadir", nadir, nadir_px), ("heads", five, five_px)):
        held: Adjusted = adjust(block, pixels)
        z[f"{name} held"] = held.z
        if name == "nadir":
            z["nadir less mean"] = float(np.std(held.error[:, 2]))
        for more, what in (("control", (9, False)), ("gnss", (0, True)), ("both", (9, True))):
            control, gnss = what
            for calibrate in (False, True):
                done = adjust(block, pixels, control=control, gnss=gnss, calibrate=calibrate)
                z[f"{name} {more}{' calibrated' * calibrate}"] = done.z
    return z


def spread(values: list[float], digits: int = 3) -> str:
    """Median and range."""
    low, middle, high = (f"{f(values):.{digits}f}" for f in (min, np.median, max))
    return f"{middle} ({low}-{high})"


def summary(
    before: dict[str, list[float]], after: dict[str, list[float]], airs: dict[str, list[float]]
) -> str:
    """The lines that README.md shows too: medians over the airs."""
    b, a = ({case: f"{np.median(v):.3f}" for case, v in z.items()} for z in (before, after))
    left = {
        name: [v for case, values in airs.items() if case.startswith(name) for v in values]
        for name in ("standard", "adjusted")
    }
    rows = [
        (
            "nadir, control, GNSS and self-calibration",
            b["nadir both calibrated"],
            a["nadir both calibrated"],
            "absorbed: not needed",
        ),
        ("nadir, control alone", b["nadir control"], a["nadir control"], "mostly absorbed"),
        (
            "nadir, orientations fixed",
            f"{b['nadir held']} ± {b['nadir less mean']}",
            a["nadir held"],
            "a constant: one number corrects it, or this program",
        ),
        ("nadir, GNSS", b["nadir gnss"], a["nadir gnss"], "needed"),
        ("five heads (45°), GNSS", b["heads gnss"], a["heads gnss"], "needed"),
        (
            "five heads, GNSS and self-calibration",
            b["heads gnss calibrated"],
            a["heads gnss calibrated"],
            "needed: self-calibration makes it worse",
        ),
        (
            "five heads, control, GNSS and self-calibration",
            b["heads both calibrated"],
            a["heads both calibrated"],
            "needed",
        ),
        (
            "nadir, calibrated in flight at 3 km, used at 6 km",
            b["carried"],
            a["carried"],
            "calibrate on corrected images",
        ),
        (
            "nadir, calibrated in flight at 6 km",
            b["calibrated here"],
            a["calibrated here"],
            "never correct on top of it",
        ),
    ]
    return "\n".join(
        [
            "| block at 6 km | height error [m] | corrected [m] | conclusion |",
            "| :-- | --: | --: | :-- |",
            *(f"| {' | '.join(row)} |" for row in rows),
            "",
            f"US 1976 leaves {percent(left['standard'])} % of the error at 3 to 9 km,"
            f" the air that the aircraft measured {percent(left['adjusted'])} %.",
        ]
    )


def percent(values: list[float]) -> str:
    """From the smallest to the largest, to two digits."""
    return f"{min(values):.2g} to {max(values):.2g}"


def document(names: list[str], columns: list[tuple[Numbers, Numbers, Numbers]]) -> str:
    """docs/when.md of the columns of all airs."""
    before, after, airs = (
        {case: [c[part][case] for c in columns] for case in columns[0][part]} for part in range(3)
    )
    cells = {
        case: f"| {text} | {spread(before[case])} | {spread(after[case], 4)} |"
        for case, text in CASES.items()
    }
    lines = [
        INTRODUCTION,
        "## Main results",
        "",
        summary(before, after, airs),
        OTHER_BLOCKS,
        "## Median and range over nine atmospheres",
        "",
        "| 6 km above ground | uncorrected [m] | corrected [m] |",
        "| :-- | --: | --: |",
        *cells.values(),
        TWICE,
        "## Each atmosphere",
        "",
        *(f"{number}. {name}" for number, name in enumerate(names, start=1)),
        "",
    ]
    for title, cases, table, digits in (
        ("Uncorrected [m]", CASES, before, 3),
        ("Corrected [m]", CASES, after, 4),
        ("Errors that remain, nadir, orientations fixed", AIRS, airs, 3),
    ):
        lines += [
            f"### {title}",
            "",
            f"|  | {' | '.join(str(i + 1) for i in range(len(names)))} |",
            "| :-- |" + " --: |" * len(names),
        ]
        lines += [
            f"| {text} | " + " | ".join(f"{v:.{digits}f}" for v in table[case]) + " |"
            for case, text in cases.items()
        ]
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    airs = real_airs()
    columns = [column(air, seed) for seed, air in enumerate(airs, start=1)]
    DOCUMENT.write_text(document([air.name[2:] for air in airs], columns), encoding="utf-8")


if __name__ == "__main__":
    main()
