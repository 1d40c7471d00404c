"""Sentences and table rows of the summary and the report, from a manifest."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.report.verdict import is_applied
from pipeline.report.words import length, shortened, significant, with_sigma

_GRAVEST_FIRST = ("finding", "loss", "warning", "fallback", "note")


def control_sentence(manifest: Mapping[str, Any]) -> str:
    """How far control points are missed before and after; empty without control."""
    control = manifest.get("control")
    if control is None:
        return ""
    before, after, moved = (
        "/".join(f"{v:.3f}" for v in control[f"rms_{name}_m"])
        for name in ("before", "after", "refraction")
    )
    share = control["part_explained"]
    sigma = control["sigma_u_m"]
    return (
        f"{control['used']} control points, intersected with the stations held: RMS of east/north/"
        f"up {before} m as measured, {after} m corrected; refraction moves them by {moved} m"
        + (f", {100.0 * share:.1f} % of what they missed (mean square)" if share > 0.0 else "")
        + (f". Stations and pixels let a height miss by {significant(sigma)} m." if sigma else ".")
    )


CONTROL_HEAD = (
    "control point [m]", "rays", "dE", "dN", "dU", "dE corr.", "dN corr.", "dU corr.", "± dU"
)  # fmt: skip


def control_rows(manifest: Mapping[str, Any], most: int) -> list[tuple[str, ...]]:
    """Intersected minus given, as measured and corrected, of some points; their mean and RMS."""
    control = manifest.get("control")
    if control is None:
        return []
    rows = [
        (shortened(p["point"], 20), str(p["rays"]), *p["before_m"], *p["after_m"], p["sigma_u_m"])
        for p in control["points"][:most]
    ]
    if len(control["points"]) > most:
        rows.append((f"({len(control['points']) - most} more: manifest.json)", "", *[None] * 7))
    for name in ("mean", "rms"):
        both = (*control[f"{name}_before_m"], *control[f"{name}_after_m"])
        rows.append((f"{name} of {control['used']}", "", *both, None))
    return [
        (
            name,
            rays,
            *("" if v is None else f"{v:+.3f}" for v in values),
            "" if sigma is None else significant(sigma, 2),
        )
        for name, rays, *values, sigma in rows
    ]


CORRECTION_HEAD = ("", "median", "95 %", "maximum")


def correction_rows(manifest: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Label, median, 95 % and maximum; camera by camera where there are several."""
    correction = manifest["correction"]
    cameras = correction["cameras"]
    rows: list[tuple[str, ...]] = []
    for key, label, unit in (
        ("shift_px", "shift in the image", " [px]"),
        ("shift_ground_m", "shift on the ground", ""),
        ("refraction_arcsec", "refraction of the air", " [arcsec]"),
        ("window_arcsec", "refraction of the window", " [arcsec]"),
    ):
        if key == "window_arcsec" and not correction[key]["maximum"]:
            continue
        for name, of_camera in (cameras if len(cameras) > 1 else {"": correction}).items():
            written = length if key == "shift_ground_m" else significant
            values = (written(of_camera[key][part]) for part in ("median", "p95", "maximum"))
            of = f", {shortened(name, 20)}" if name else ""
            rows.append((f"{label}{of}{unit}", *values))
    return rows


def air_sentences(manifest: Mapping[str, Any]) -> str:
    """What the air was estimated from, and how it differs from the standard and changes."""
    profile = manifest["profile"]
    reason = profile["reason"]
    first = reason.split()[0] if reason else ""
    # A key of the mission file, such as atmosphere.use, keeps its lower case.
    sentence = f"{reason}." if "." in first else f"{reason[:1].upper()}{reason[1:]}."
    if profile["basis"] != "standard" and profile["departure_at_cameras_k"] is not None:
        sentence += (
            f" At the height of the cameras the air is {profile['departure_at_cameras_k']:+.1f} K "
            f"against {profile['standard']}."
        )
    if profile["windows"]:
        changes = [100.0 * window["change"] for window in profile["windows"]]
        sentence += (
            f" The air changes: R by {min(changes):+.1f} to {max(changes):+.1f} % of that of the "
            f"whole flight; {profile['profiles']} profiles follow it."
        )
    return sentence


def effect_lines(effects: Sequence[Mapping[str, Any]], standard: str) -> list[str]:
    """R in the air of the flight beside that in the standard, a line for each nadir angle."""
    return [
        f"R at {effect['nadir_angle_deg']:.0f}° from {effect['h_c_m']:.0f} m to "
        f"{effect['h_g_m']:.0f} m: {with_sigma(effect['r_c_arcsec'], effect['sigma_arcsec'])} "
        f"arcsec, {effect['standard_arcsec']:.3f} in {standard}: "
        + with_sigma(
            100.0 * (effect["factor"] - 1.0),
            None if effect["sigma_factor"] is None else 100.0 * effect["sigma_factor"],
            "%",
            signed=True,
        )
        for effect in effects
    ]


SENSOR_HEAD = ("sensor error", "estimate ± sigma", "prior sigma")


def sensor_rows(manifest: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Estimated errors of the sensors, each with its sigma and the prior sigma."""
    return [
        (s["what"], with_sigma(s["value"], s["sigma"]), f"{s['expected_sigma']:.2g}")
        for s in manifest["profile"]["sensors"]
    ]


SOURCE_HEAD = (
    "source", "readings", "RMS [sigma]", "sigma inflation factor", "degrees of freedom for signal",
)  # fmt: skip


def source_rows(manifest: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The sources that were used: residuals, and information content."""
    return [
        (
            f"{s['source']}, {s['quantity']}",
            str(s["readings"]),
            f"{s['rms_sigma']:.2f}",
            f"{s['sigma_inflation']:.2f}",
            f"{s['degrees_of_freedom_for_signal']:.1f}",
        )
        for s in manifest["profile"]["sources"]
        if s["used"] and "quantity" in s
    ]


def unused_sources(manifest: Mapping[str, Any]) -> list[str]:
    """Sources that were not used, each with the reason."""
    return [
        f"{s['source']}: {s['why_not']}" for s in manifest["profile"]["sources"] if not s["used"]
    ]


def ledger_rows(entries: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, str]]:
    """Kind, code and text of the entries of a ledger, the gravest first.

    The place is appended to a text that does not name it.
    """
    rows = []
    for entry in entries:
        what, where = entry["what"], entry["where"]
        text = what if where in what else f"{what} ({where})"
        rows.append((entry["kind"], entry["code"], text))
    return sorted(rows, key=lambda row: (_GRAVEST_FIRST.index(row[0]), row[1]))


def not_included(manifest: Mapping[str, Any]) -> list[str]:
    """Effects that the coordinates still contain (or lack, if refraction was applied)."""
    applied = is_applied(manifest)
    remains = "not applied" if applied else "not removed"
    without_lens, behind_glass = [], []
    for name, camera in manifest["config"]["cameras"].items():
        if camera["principal_distance"] is None:
            without_lens.append(name)
        window = camera["window"]
        if window and (window["shape"], window["in_calibration"]) == ("plane", "none"):
            behind_glass.append(name)
    lines = []
    if without_lens:
        lines.append(
            f"The principal distance of {', '.join(without_lens)} changes with the air in the lens "
            f"(130 to 310 ppm at 6 km on a 153 mm lens, about in proportion to the height; as much "
            f"as refraction itself): {remains}."
        )
    if behind_glass:
        lines.append(
            f"The glass before {', '.join(behind_glass)} displaces rays, by 7 mm for 20 mm of "
            f"glass at 45°: {remains}."
        )
    lean = manifest.get("heights", {}).get("deflection", {})
    if lean.get("applies") and lean["north_arcsec"] is not None and not applied:
        size = math.hypot(lean["north_arcsec"], lean["east_arcsec"])
        lines.append(
            f"Deflection of the vertical: the plumb line, by which autopilots are levelled, leans "
            f"{size:.1f} arcsec ({lean['geoid']}), {math.radians(size / 3.6):.3f} m on the ground "
            "for each kilometre of height: not removed, unless a trajectory allows for it."
        )
    if not applied:
        lines.append(
            "Earth curvature and map projection: adjust in earth-centred or one local "
            "east-north-up frame."
        )
    return lines
