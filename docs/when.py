"""Writes docs/when.md: who needs a correction of refraction, and who does not, in metres.

Run it in the root of the repository:  .venv/bin/python -m docs.when

Blocks of simulated images in the air of nine real soundings, rays by the simulator's ODE, adjusted
by pycolmap: `tests/golden/adjusted_block.py`. Takes one minute.
"""

from pathlib import Path

import numpy as np

from tests.golden.adjusted_block import (
    US1976,
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

REMAINING = {
    "without": "uncorrected [m]",
    "standard": "left by US 1976 [%]",
    "adjusted": "left by the adjusted air [%]",
}
HEIGHTS_KM = (3, 6, 9)
AIRS = {
    f"{name} {height_km}": f"{text}, {height_km} km"
    for height_km in HEIGHTS_KM
    for name, text in REMAINING.items()
}
"""Height error of nadir blocks with orientations fixed, and what two airs leave of it."""

INTRODUCTION = """\
# Who needs a correction of refraction

Written by `python -m docs.when`. Do not edit this page.

The table compares simulated blocks with known truth:

* 6 km above ground, f = 20,000 px, 60 and 30 % overlap, 300 random points
  0 to 300 m high. Only points in two or more images are used: about 150 in the nadir block, about
  295 with five heads;
* 20 nadir images, or some 130 of five heads (nadir and four at 45°) that see the points from all
  sides;
* rays from an ODE through nine atmospheres from real soundings;
* adjusted with pycolmap;
* no error except refraction in the uncorrected images: no noise, true positions.

The adjustments differ:

* *Fixed*: only points are adjusted.
* *GNSS*: positions are priors of 3 and 5 cm against 0.3 px, attitudes are free.
* *Control*: nine points are fixed at their true places, orientations are free.
* *Self-calibration*: f, k1, k2 of each camera are unknown.

Errors are root mean squares of the heights of all points except the control points. *Corrected*
uses the air that `unbend` determines from the flight's own sensors and a climatology. The sensors
are biased, lag and drift.
"""
OTHER_BLOCKS = """
Another layout of a block gives other numbers, and real adjustments have other errors too. At 120 m
above ground, refraction is 0.3 arcsec at a nadir angle of 45°: in the middle of an oblique image
0.006 px with f = 4,000 px, and 0.03 px with f = 20,000 px.

The simulated lens is not affected by the air in it. A lens with outside air in it is: Meier
computed for one of 153 mm, calibrated in a laboratory, that its principal distance is wrong at 6
km by 130 ppm behind a pressurised window and by up to 310 ppm in the outside air. That is 0.8 to
1.9 m of height if nothing absorbs it, more than refraction does to a nadir block in this table.
Other lenses differ, and a sealed lens may have none.

`unbend` removes most of it if the mission file states [the air of the
calibration](pages/guide/lens.md). Self-calibration absorbs it too; in a nadir block so does control
without GNSS, mostly.
"""
TWICE = """
In the last two rows the calibration was estimated from uncorrected images (control, GNSS), so it
contains refraction. Corrected images then have it twice.
"""

CONCLUSIONS = """
nadir, control, GNSS and self-calibration|nadir both calibrated|absorbed: not needed
nadir, control alone|nadir control|mostly absorbed
nadir, orientations fixed|nadir held|a constant: one number corrects it, or this program
nadir, GNSS|nadir gnss|needed
five heads (45°), GNSS|heads gnss|needed
five heads, GNSS and self-calibration|heads gnss calibrated|needed: self-calibration makes it worse
five heads, control, GNSS and self-calibration|heads both calibrated|needed
nadir, calibrated in flight at 3 km, used at 6 km|carried|calibrate on corrected images
nadir, calibrated in flight at 6 km|calibrated here|never correct on top of it
"""
"""Blocks of the summary, their cases, and what to do."""

LENS = (
    "| in addition, the air in the lens: calibrated on the ground at 20 °C (not simulated) "
    "| 0.8 to 1.9 | a quarter of it | state the air of the calibration |"
)
"""The row of the summary that Meier's figures give: docs/pages/guide/lens.md."""

Numbers = dict[str, float]
Table = dict[str, list[float]]


def column(air: RealAir, seed: int) -> tuple[Numbers, Numbers, Numbers]:
    """Height errors [m] uncorrected and corrected with the adjusted air, and what airs leave.

    Root mean squares over the points that are no control, 6 km above ground.
    """
    rng = np.random.default_rng(seed)
    nadir = {h: fly_block(air, 1000.0 * h, seed, heads()[:1]) for h in HEIGHTS_KM}
    adjusted = {h: air.adjusted_profile(1000.0 * h, rng) for h in HEIGHTS_KM}
    airs: Numbers = {}
    for h, block in nadir.items():
        uncorrected = adjust(block, block.measured).z
        left_by_standard = adjust(block, correct(block, US1976)).z
        left_by_adjusted = adjust(block, correct(block, adjusted[h])).z
        airs[f"without {h}"] = uncorrected
        airs[f"standard {h}"] = 100.0 * left_by_standard / uncorrected
        airs[f"adjusted {h}"] = 100.0 * left_by_adjusted / uncorrected

    block = nadir[6]
    five = fly_block(air, HEIGHT, seed, heads(), lines=7, shots=11, most=16)
    corrected = correct(block, adjusted[6])
    before = heights(block, five, block.measured, five.measured)
    after = heights(block, five, corrected, correct(five, adjusted[6]))
    # The calibrations were estimated on uncorrected images, whatever is done with the images after.
    for name, calibrated in (("carried", nadir[3]), ("calibrated here", block)):
        calibration = adjust(
            calibrated,
            calibrated.measured,
            control=9,
            gnss=True,
            calibrate=True,
        )
        interior = calibration.interior
        before[name] = adjust(block, block.measured, interior=interior).z
        after[name] = adjust(block, corrected, interior=interior).z
    return before, after, airs


def heights(nadir: Block, five: Block, nadir_px: np.ndarray, five_px: np.ndarray) -> Numbers:
    """Height errors [m] of the cases in which images and their calibration belong together."""
    fixed = adjust(nadir, nadir_px)
    less_mean = float(np.std(fixed.error[:, 2]))
    return {
        "nadir held": fixed.z,
        "nadir less mean": less_mean,
        **free_heights("nadir", nadir, nadir_px),
        "heads held": adjust(five, five_px).z,
        **free_heights("heads", five, five_px),
    }


def free_heights(name: str, block: Block, pixels: np.ndarray) -> Numbers:
    """Height errors [m] of a block whose orientations are adjusted."""
    z: Numbers = {}
    for kind, control, gnss in (("control", 9, False), ("gnss", 0, True), ("both", 9, True)):
        case = f"{name} {kind}"
        z[case] = adjust(block, pixels, control=control, gnss=gnss).z
        calibrated = adjust(block, pixels, control=control, gnss=gnss, calibrate=True)
        z[f"{case} calibrated"] = calibrated.z
    return z


def spread(values: list[float], digits: int = 3) -> str:
    """Median and range."""
    low = f"{min(values):.{digits}f}"
    middle = f"{np.median(values):.{digits}f}"
    high = f"{max(values):.{digits}f}"
    return f"{middle} ({low}-{high})"


def median(values: list[float]) -> str:
    return f"{np.median(values):.3f}"


def summary(before: Table, after: Table, airs: Table) -> str:
    """The lines that README.md shows too: medians over the airs."""
    lines = [
        "| block at 6 km | height error [m] | corrected [m] | conclusion |",
        "| :-- | --: | --: | :-- |",
    ]
    for row in CONCLUSIONS.strip().splitlines():
        block, case, conclusion = row.split("|")
        uncorrected = median(before[case])
        if case == "nadir held":
            uncorrected += f" ± {median(before['nadir less mean'])}"
        lines.append(f"| {block} | {uncorrected} | {median(after[case])} | {conclusion} |")
    lines.append(LENS)
    standard: list[float] = []
    adjusted: list[float] = []
    for h in HEIGHTS_KM:
        standard += airs[f"standard {h}"]
        adjusted += airs[f"adjusted {h}"]
    lines += [
        "",
        f"Of the third row's error, US 1976 leaves {percent(standard)} % at 3 to 9 km, the air that"
        f" the aircraft measured {percent(adjusted)} %.",
    ]
    return "\n".join(lines)


def percent(values: list[float]) -> str:
    """From the smallest to the largest, to two digits."""
    return f"{min(values):.2g} to {max(values):.2g}"


def table_of(title: str, cases: dict[str, str], table: Table, digits: int) -> list[str]:
    """A section with the numbers of each air."""
    count = len(next(iter(table.values())))
    numbers = [str(number) for number in range(1, count + 1)]
    lines = [
        f"### {title}",
        "",
        f"|  | {' | '.join(numbers)} |",
        "| :-- |" + " --: |" * count,
    ]
    for case, text in cases.items():
        cells = [f"{value:.{digits}f}" for value in table[case]]
        lines.append(f"| {text} | {' | '.join(cells)} |")
    return [*lines, ""]


def table_over_airs(columns: list[Numbers]) -> Table:
    """The numbers of each case in all airs."""
    return {case: [column[case] for column in columns] for case in columns[0]}


def document(names: list[str], columns: list[tuple[Numbers, Numbers, Numbers]]) -> str:
    """docs/when.md of the columns of all airs."""
    before, after, airs = map(table_over_airs, zip(*columns, strict=True))
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
    ]
    for case, text in CASES.items():
        lines.append(f"| {text} | {spread(before[case])} | {spread(after[case], 4)} |")
    lines += [TWICE, "## Each atmosphere", ""]
    lines += [f"{number}. {name}" for number, name in enumerate(names, start=1)]
    lines.append("")
    lines += table_of("Uncorrected [m]", CASES, before, 3)
    lines += table_of("Corrected [m]", CASES, after, 4)
    lines += table_of("Errors that remain, nadir, orientations fixed", AIRS, airs, 3)
    return "\n".join(lines)


def main() -> None:
    airs = real_airs()
    columns = [column(air, seed) for seed, air in enumerate(airs, start=1)]
    DOCUMENT.write_text(document([air.name[2:] for air in airs], columns), "utf-8")


if __name__ == "__main__":
    main()
