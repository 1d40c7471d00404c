"""Sentences on a run, the next steps, and rows of tables, made from its manifest."""

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from unbend.messages import MessageRecord
from unbend.report.cabin_steps import cabin_step, step_to_stated_sigmas
from unbend.report.concerns import concerns_of
from unbend.report.lens_sentences import (
    SMALLEST_MEASURABLE_PX,
    lens_left_in,
    lens_step,
    limits_of_lenses,
    reference_step,
    typical_lenses,
    uncorrected_lenses,
)
from unbend.report.words import count, length, pixels, shortened, significant, with_sigma
from unbend.tables.manifest.results import (
    CameraShifts,
    CorrectionRecord,
    DistributionRecord,
    EffectRecord,
    ResultsRecord,
    TimeWindowRecord,
)
from unbend.tables.manifest.whole import Manifest

Metres = Sequence[float | None]
"""East, north and up [m]; None for an unknown component."""

LARGEST_CABIN_SHARE = 0.02
"""From this standard deviation on, as a share of R, the report mentions the air in the cabin."""

_NEARLY_ALL = 0.9  # share of the observations
# Basis of the air without measurements -> its description.
_UNMEASURED = {
    "climatology": "a climatology is used instead",
    "standard": "a standard atmosphere is used instead",
}


def is_applied(manifest: Manifest) -> bool:
    """Whether the run applied refraction to ideal observations, instead of removing it."""
    return manifest.sections.refraction.direction == "apply"


def verdict(manifest: Manifest) -> str:
    """The result of a run in a sentence or two: the `outcome`, and uncorrected air in lenses."""
    lens = "" if is_nothing_corrected(manifest) else lens_left_in(manifest.results)
    return f"{outcome(manifest)} {lens}".rstrip()


def is_nothing_corrected(manifest: Manifest) -> bool:
    """Whether no observation was corrected."""
    return not manifest.results.correction.shift_px.count


def outcome(manifest: Manifest) -> str:
    """One sentence: how many observations were corrected, by how much, and whether to use them.

    The amounts are the median and the 95th percentile: the maximum may be that of one steep ray.
    Results are called ready for bundle adjustment only if nothing has to be checked before.
    """
    correction = manifest.results.correction
    rows = manifest.results.observations.rows
    corrected = correction.shift_px.count
    applied = is_applied(manifest)
    verb = "displaced" if applied else "corrected"
    concerns = "; ".join(text for text, _ in concerns_of(manifest))
    if not corrected:
        check = f"; check {concerns}" if concerns else ""
        return f"None of {count(rows, 'observation')} could be {verb}: {flagged(manifest)}{check}."
    if corrected < rows:
        start = f"{corrected:,} of {rows:,} observations were"
    elif rows == 1:
        start = "The observation was"
    else:
        start = f"All {rows:,} observations were"
    if concerns:
        end = f". Check {concerns} before use"
    elif is_tiny(manifest):
        end = f", too small to measure: not needed here{condition_of_frame(manifest)}"
    elif applied:
        end = ", for simulations and tests: they now contain refraction"
    else:
        without = ""
        if corrected < rows:
            without = f" without the other {count(rows - corrected, 'row')}"
        end = f". Ready for bundle adjustment{without}"
    return f"{start} {verb} by {size_of_shift(correction)}{end}."


def size_of_shift(correction: CorrectionRecord) -> str:
    """The median and 95th percentile of the shift of observations, on the ground and in the image.

    Lengths on the ground are left out if they are unknown.
    """
    shift = correction.shift_px
    ground = correction.shift_ground_m
    if ground.median is None:
        return f"{pixels(shift.median)} in the image (median; 95 %: {pixels(shift.p95)})"
    return (
        f"{length(ground.median)} on the ground, {pixels(shift.median)} in the image "
        f"(median; 95 %: {length(ground.p95)}, {pixels(shift.p95)})"
    )


def condition_of_frame(manifest: Manifest) -> str:
    """A condition for the end of a sentence if nothing confirms the frame of a block, else ""."""
    if any(entry.code == "FRAME-UNVERIFIED" for entry in manifest.results.ledger):
        return ", if the frame of the block is right (nothing confirms it)"
    return ""


def remarks(manifest: Manifest) -> list[str]:
    """Sentences below the verdict: limits of the accuracy, and residuals of control points."""
    sentences = [text for text, _ in _limits(manifest)]
    control = manifest.results.control
    if control is not None:
        before = length(distance(control.rms_before_m))
        after = length(distance(control.rms_after_m))
        points = count(control.used, "control point")
        verb = "displaced" if is_applied(manifest) else "corrected"
        sentences.append(f"{points}: RMS distance {before} as measured, {after} {verb}.")
    return sentences


def distance(components_m: Sequence[float]) -> float:
    """The length of a vector [m]."""
    return math.sqrt(sum(value**2 for value in components_m))


def next_steps(manifest: Manifest) -> list[str]:
    """Sentences on what to do with the results of a run, one step each.

    Checks come first, then steps against remaining errors: the air in a lens, which is systematic,
    before the uncertainty of the air outside and in cabins.
    """
    steps = [step for _, step in concerns_of(manifest)]
    adjust = "Then adjust" if steps else "Adjust"
    rows = manifest.results.observations.rows
    corrected = manifest.results.correction.shift_px.count
    applied = is_applied(manifest)
    if not corrected:
        return [*steps, "Find the cause in the losses, correct the mission file, run again."]
    if corrected < rows:
        steps.append(
            f"Leave out {count(rows - corrected, 'row')} without new coordinates "
            f"({flagged(manifest)}); the ledger names the causes."
        )
    lenses = uncorrected_lenses(manifest.results)
    if lenses:
        steps.append(reference_step(lenses))
    steps += [step for _, step in _limits(manifest)]
    steps += _step_to_known_hour(manifest)
    steps += step_to_stated_sigmas(manifest)
    if is_tiny(manifest):
        steps.append("Use the results or the measurements: the difference is not measurable.")
    if applied:
        steps.append("Use x_displaced_px, y_displaced_px as measurements with known refraction.")
    else:
        steps += [
            f"{adjust} x_corrected_px, y_corrected_px, or export them: unbend export.",
            "Switch off the refraction correction of the adjustment program: never correct twice.",
        ]
    return steps


def flagged(manifest: Manifest) -> str:
    """The numbers of observations of the run with each status other than ok, as a text."""
    return counted(manifest.results.observations.status)


def counted(status: Mapping[str, int]) -> str:
    """The numbers of each status other than ok, as a text; zeros are left out.

    >>> counted({"ok": 7, "no_ground": 0, "no_station": 1200})
    '1,200 no_station'
    """
    return ", ".join(f"{n:,} {name}" for name, n in status.items() if n and name != "ok")


def is_tiny(manifest: Manifest) -> bool:
    """Whether 90 % of the observations were corrected, each by less than 0.05 px.

    Less than `SMALLEST_MEASURABLE_PX` cannot be seen in image measurements.
    """
    shift = manifest.results.correction.shift_px
    is_nearly_all = shift.count > _NEARLY_ALL * manifest.results.observations.rows
    return is_nearly_all and shift.maximum is not None and shift.maximum < SMALLEST_MEASURABLE_PX


def _limits(manifest: Manifest) -> list[tuple[str, str]]:
    """Sentences on what limits the accuracy, each with a step that would improve it.

    Limits are air that was not measured, and the air in a cabin or in lenses.
    """
    limits = []
    air = manifest.results.uncertainty
    basis = manifest.results.profile.basis
    sigma = "" if air is None else f" ± {100.0 * air.scale_sigma:.2g} %"
    if basis in _UNMEASURED:
        accuracy = f", the correction is known to{sigma} of the refraction R" if sigma else ""
        step = step_to_better_air(manifest)
        limits.append((f"The air was not measured: {_UNMEASURED[basis]}{accuracy}.", step))
    cabin_share = manifest.results.cabin_sigma_share.median
    if cabin_share is not None and cabin_share > LARGEST_CABIN_SHARE:
        limits.append(_limit_of_cabin(manifest, cabin_share))
    elif not is_applied(manifest):
        limits += limits_of_lenses(manifest.results)
    return limits


def _step_to_known_hour(manifest: Manifest) -> list[str]:
    """A step to state the hour of the flight, if only its day is known; else empty."""
    for entry in manifest.results.ledger:
        if entry.code == "FLIGHT-HOUR":
            return [f"State the time of the flight too ({entry.where}): the air is more certain."]
    return []


def _limit_of_cabin(manifest: Manifest, share: float) -> tuple[str, str]:
    """A sentence on the uncertainty by the air in front of and in the lens, and a step against it.

    ``share`` is its median standard deviation as a share of R.
    """
    place = "in the cabin"
    if all(camera.window is None for camera in manifest.sections.cameras.values()):
        place = "in front of the lens"
    causes = f"The air {place} causes"
    lenses = typical_lenses(manifest.results)
    if lenses:
        ppm = max(camera.lens_sigma_ppm or 0.0 for camera in lenses.values())
        causes = (
            f"The air {place} and the unknown part of a typical lens ({ppm:.2g} ppm of the "
            "principal distance) cause"
        )
    text = f"{causes} a median uncertainty of {100.0 * share:.2g} % of the refraction R"
    air = manifest.results.uncertainty
    if air is not None:
        text += f", the air outside of {100.0 * air.scale_sigma:.2g} %"
        if share > air.scale_sigma:
            text += " only"
    step = lens_step(lenses) if lenses else cabin_step(manifest)
    return f"{text}.", step


def step_to_better_air(manifest: Manifest) -> str:
    """The step to better air: measure it, or remove ``adjust: false``, which ignores that."""
    if manifest.sections.atmosphere.adjust:
        return "For a better correction, give a thermometer, soundings or METARs."
    return (
        "For a better correction, remove atmosphere.adjust: false. With it, neither measured air "
        "nor a climatology is used."
    )


_GRAVEST_FIRST = ("finding", "loss", "warning", "fallback", "note")


def control_sentence(manifest: Manifest) -> str:
    """A sentence on the residuals of control points before and after; empty without any."""
    control = manifest.results.control
    if control is None:
        return ""
    before = slashed(control.rms_before_m)
    after = slashed(control.rms_after_m)
    moved = slashed(control.rms_refraction_m)
    text = (
        f"{control.used} control points, intersected with fixed stations: RMS of east/north/"
        f"up {before} m as measured, {after} m corrected; the corrections move them by {moved} m"
    )
    if control.part_explained > 0.0:
        percent = 100.0 * control.part_explained
        text += f", {percent:.1f} % of their mean square residual"
    text += "."
    if control.sigma_u_m:
        sigma = significant(control.sigma_u_m)
        text += f" The sigma of a height from stations and pixels is {sigma} m."
    return text


def slashed(values_m: Iterable[float]) -> str:
    """East, north and up [m] to a millimetre, with slashes between them: 0.012/0.020/0.153."""
    return "/".join(f"{value:.3f}" for value in values_m)


CONTROL_HEAD = (
    "control point [m]",
    "rays",
    "dE",
    "dN",
    "dU",
    "dE corr.",
    "dN corr.",
    "dU corr.",
    "± dU",
)


def control_rows(manifest: Manifest, most: int) -> list[tuple[str, ...]]:
    """Rows below `CONTROL_HEAD`: the first ``most`` control points, then the mean and RMS of all.

    Differences are intersected minus stated coordinates, as measured and corrected.
    """
    control = manifest.results.control
    if control is None:
        return []
    rows = []
    for point in control.points[:most]:
        sigma = "" if point.sigma_u_m is None else significant(point.sigma_u_m, 2)
        differences = signed(point.before_m, point.after_m)
        rows.append((shortened(point.point, 20), str(point.rays), *differences, sigma))
    if len(control.points) > most:
        rows.append((f"({len(control.points) - most} more: manifest.json)", *[""] * 8))
    mean = signed(control.mean_before_m, control.mean_after_m)
    rms = signed(control.rms_before_m, control.rms_after_m)
    rows.append((f"mean of {control.used}", "", *mean, ""))
    rows.append((f"rms of {control.used}", "", *rms, ""))
    return rows


def signed(before_m: Metres, after_m: Metres) -> list[str]:
    """The six components of two vectors with their signs, to a millimetre; "" for None."""
    return ["" if value is None else f"{value:+.3f}" for value in (*before_m, *after_m)]


CORRECTION_HEAD = ("", "median", "95 %", "maximum")


def correction_rows(manifest: Manifest) -> list[tuple[str, ...]]:
    """Rows below `CORRECTION_HEAD`: shifts and refraction angles, of each camera if several."""
    correction = manifest.results.correction
    cameras: Mapping[str, CorrectionRecord | CameraShifts] = correction.cameras
    if len(cameras) < 2:
        cameras = {"": correction}
    rows = []
    for name, sizes in cameras.items():
        rows.append(distribution_row("shift in the image", name, sizes.shift_px, "px"))
    for name, sizes in cameras.items():
        rows.append(distribution_row("shift on the ground", name, sizes.shift_ground_m, "m"))
    for name, sizes in cameras.items():
        rows.append(
            distribution_row("refraction of the air", name, sizes.refraction_arcsec, "arcsec")
        )
    if correction.window_arcsec.maximum:
        for name, sizes in cameras.items():
            label = "refraction of the window"
            rows.append(distribution_row(label, name, sizes.window_arcsec, "arcsec"))
    return rows


def distribution_row(
    label: str, camera: str, distribution: DistributionRecord, unit: str
) -> tuple[str, ...]:
    """Label, median, 95 % and maximum of a distribution in ``unit``, for a row of a table.

    The label contains the name of the ``camera`` unless it is "". Metres get units of their own.
    """
    if camera:
        label = f"{label}, {shortened(camera, 20)}"
    values = (distribution.median, distribution.p95, distribution.maximum)
    if unit == "m":
        return (label, *(length(value) for value in values))
    return (f"{label} [{unit}]", *(significant(value) for value in values))


def air_sentences(manifest: Manifest) -> str:
    """Sentences on the source of the air, its difference from the standard, and its changes."""
    profile = manifest.results.profile
    reason = profile.reason
    first = reason.split()[0] if reason else ""
    # A key of the mission file, such as atmosphere.use, keeps its lower case.
    sentence = f"{reason}." if "." in first else f"{reason[:1].upper()}{reason[1:]}."
    departure_k = profile.departure_at_cameras_k
    sigma_k = profile.sigma_departure_at_cameras_k
    if profile.basis != "standard" and departure_k is not None and sigma_k is not None:
        departure = with_sigma(departure_k, sigma_k, "K", signed=True)
        sentence += (
            f" At the height of the cameras, the air differs by {departure} from "
            f"{profile.standard}."
        )
    if profile.windows:
        least = min(profile.windows, key=lambda window: window.change)
        most = max(profile.windows, key=lambda window: window.change)
        sentence += (
            f" The air changes: R changes by {change_of(least)} to {change_of(most)} % of R of the "
            f"whole flight; there are {profile.profiles} profiles."
        )
    return sentence


def change_of(window: TimeWindowRecord) -> str:
    """The change of R in a part of a flight [% of R of the whole], with its sigma, as a text."""
    return with_sigma(100.0 * window.change, 100.0 * window.sigma, signed=True)


def effect_lines(effects: Sequence[EffectRecord], standard: str) -> list[str]:
    """Lines on R in the air of the flight and in the standard, one for each nadir angle.

    ``standard`` is the name of that atmosphere. The first line explains what R is.
    """
    lines: list[str] = []
    for effect in effects:
        name = "R" if lines else "refraction R"
        in_flight = with_sigma(effect.r_c_arcsec, effect.sigma_arcsec)
        sigma = None if effect.sigma_factor is None else 100.0 * effect.sigma_factor
        difference = with_sigma(100.0 * (effect.factor - 1.0), sigma, "%", signed=True)
        lines.append(
            f"{name} at {effect.nadir_angle_deg:.0f}° from {effect.h_c_m:.0f} m to "
            f"{effect.h_g_m:.0f} m: {in_flight} arcsec, "
            f"{effect.standard_arcsec:.3f} in {standard}: {difference}"
        )
    return lines


def ledger_rows(entries: Sequence[MessageRecord]) -> list[tuple[str, str, str]]:
    """Kind, code and text of the entries of a ledger, sorted by severity of the kind, then code.

    The text contains the place of the entry.
    """
    rows = []
    for entry in entries:
        text = entry.what if entry.where in entry.what else f"{entry.what} ({entry.where})"
        rows.append((entry.kind, entry.code, text))
    return sorted(rows, key=lambda row: (_GRAVEST_FIRST.index(row[0]), row[1]))


def not_included(manifest: Manifest) -> list[str]:
    """Lines on effects that the coordinates still contain (or lack, if refraction was applied)."""
    applied = is_applied(manifest)
    remains = "not applied" if applied else "not removed"
    without_lens = []
    behind_glass = []
    for name, camera in manifest.sections.cameras.items():
        if camera.principal_distance is None:
            without_lens.append(name)
        window = camera.window
        if window is not None and window.shape == "plane" and window.in_calibration == "none":
            behind_glass.append(name)
    texts = report_texts()["left"]
    lines = []
    lines += lines_on_air(manifest.results, remains)
    if without_lens and not manifest.results.air_at_cameras:
        lines.append(texts["lens"].format(names=", ".join(without_lens), remains=remains))
    if behind_glass:
        lines.append(texts["glass"].format(names=", ".join(behind_glass), remains=remains))
    deflection = manifest.results.heights.deflection
    if deflection.applies and deflection.north_arcsec is not None and not applied:
        size = math.hypot(deflection.north_arcsec, deflection.east_arcsec or 0.0)
        across = math.radians(size / 3.6)  # metres on the ground from 1 km above it
        lines.append(texts["vertical"].format(size=size, geoid=deflection.geoid, across=across))
    if not applied:
        lines.append(texts["curvature"])
    return lines


def lines_on_air(results: ResultsRecord, remains: str) -> list[str]:
    """Lines on remaining effects of the air in and in front of each lens.

    ``remains`` is the word for them: "not removed" or "not applied".
    """
    texts = report_texts()["left"]
    lines = []
    for name, camera in results.air_at_cameras.items():
        height = ""
        if camera.lens_height_m is not None:
            height = f", {length(camera.lens_height_m)} of height"
        size = with_sigma(abs(camera.lens_ppm), camera.lens_sigma_ppm, "ppm")
        if not camera.lens_removed:
            lines.append(
                texts["lens_size"].format(name=name, size=size, height=height, remains=remains)
            )
        elif camera.lens_sigma_ppm is not None:
            lines.append(texts["lens_typical"].format(name=name, size=size))
        if camera.before_lens == "outside" and camera.kelvin_share is not None:
            percent = significant(100.0 * camera.kelvin_share, 2)
            lines.append(texts["opening"].format(name=name, percent=percent, remains=remains))
    return lines


@cache
def report_texts() -> Mapping[str, Any]:
    """The texts of ``report.toml``, by section and key."""
    text = (files("unbend.report") / "data/report.toml").read_text("utf-8")
    return tomllib.loads(text)
