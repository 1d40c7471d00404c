"""The sentences of the summary and the report, from a manifest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

_ORDER = ("loss", "warning", "fallback", "note")


def headline(manifest: Mapping[str, Any]) -> str:
    """How large the correction was, in one sentence, without overselling it."""
    shift = manifest["correction"]["shift_px"]
    ground = manifest["correction"]["shift_ground_m"]
    rows = manifest["observations"]["rows"]
    done = "displaced" if is_applied(manifest) else "corrected"
    if not shift["count"]:
        return f"None of the {rows:,} observations could be {done}."
    sentence = (
        f"{shift['count']:,} of {rows:,} observations were {done}, by {figure(shift['median'])} "
        f"px in the median and {figure(shift['maximum'])} px at most: "
        f"{figure(ground['median'])} m and {figure(ground['maximum'])} m on the ground."
    )
    if shift["maximum"] < 0.05:
        sentence += " That is far below what can be measured in an image."
    return sentence


def figure(value: float | None) -> str:
    """A number to three digits, plainly.

    >>> figure(0.006234), figure(12.345), figure(1234.5), figure(2e-9), figure(None)
    ('0.00623', '12.3', '1234', '<0.001', '-')
    """
    if value is None:
        return "-"
    if value == 0.0:
        return "0"
    if abs(value) < 5e-4:
        return "<0.001"
    if abs(value) >= 1000.0:
        return f"{value:.0f}"
    return f"{value:.3g}"


CORRECTION_HEAD = ("", "median", "95 %", "maximum")


def correction_rows(manifest: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Label, median, 95 % and maximum; camera by camera where there are several."""
    correction = manifest["correction"]
    cameras = correction["cameras"]
    rows: list[tuple[str, ...]] = []
    for key, label in (
        ("shift_px", "shift in the image [px]"),
        ("shift_ground_m", "shift on the ground [m]"),
        ("refraction_arcsec", "refraction of the air [arcsec]"),
        ("window_arcsec", "refraction of the window [arcsec]"),
    ):
        if key == "window_arcsec" and not correction[key]["maximum"]:
            continue
        several = cameras if len(cameras) > 1 else {"": correction}
        for name, own in several.items():
            values = (figure(own[key][part]) for part in ("median", "p95", "maximum"))
            rows.append((f"{label} {name}".rstrip(), *values))
    return rows


def where_from(manifest: Mapping[str, Any]) -> str:
    """Which air was used, and why."""
    profile = manifest["profile"]
    reason = profile["reason"]
    first = reason.split()[0] if reason else ""
    # The key of a mission file is written as it is.
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
    method = manifest["config"]["refraction"]["method"]
    if method != "spherical":
        sentence += f" Rays by the published method {method}, for comparison, not for work."
    return sentence


def effect_lines(effects: Sequence[Mapping[str, Any]], standard: str) -> list[str]:
    """R in the air of the flight beside that in the standard, a line an angle."""
    return [
        f"R at {e['nadir_angle_deg']:.0f}° from {e['h_c_m']:.0f} m to {e['h_g_m']:.0f} m: "
        f"{e['r_c_arcsec']:.3f}{_plus_minus(e['sigma_arcsec'], '.3f')} arcsec, "
        f"{e['standard_arcsec']:.3f} in {standard}: "
        f"{100.0 * (e['factor'] - 1.0):+.2f}{_percent(e['sigma_factor'])} %"
        for e in effects
    ]


def _plus_minus(sigma: float | None, digits: str) -> str:
    return "" if sigma is None else f" ± {sigma:{digits}}"


def _percent(sigma: float | None) -> str:
    return _plus_minus(None if sigma is None else 100.0 * sigma, ".2f")


SENSOR_HEAD = ("", "found", "sigma", "expected sigma")


def sensor_rows(manifest: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """What was found wrong with the sensors, with its sigma and that of what was expected."""
    return [
        (s["what"], f"{s['value']:.3g}", f"{s['sigma']:.2g}", f"{s['expected_sigma']:.2g}")
        for s in manifest["profile"]["sensors"]
    ]


SOURCE_HEAD = (
    "source",
    "readings",
    "RMS [sigma]",
    "sigma inflation",
    "degrees of freedom for signal",
)


def source_rows(manifest: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The sources that were used: how they fit, and their information content."""
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


def ledger_rows(manifest: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Kind, code and text of the ledger, the gravest first."""
    rows = [(e["kind"], e["code"], located(e)) for e in manifest["ledger"]]
    return sorted(rows, key=lambda row: (_ORDER.index(row[0]), row[1]))


def located(entry: Mapping[str, Any]) -> str:
    """The text of an entry of the ledger, and where it was if it does not say so itself."""
    what, where = entry["what"], entry["where"]
    return what if where in what else f"{what} ({where})"


def is_applied(manifest: Mapping[str, Any]) -> bool:
    """Whether the run displaced ideal observations instead of correcting measured ones."""
    return bool(manifest["config"]["refraction"]["direction"] == "apply")


def not_included(manifest: Mapping[str, Any]) -> list[str]:
    """What the coordinates still hold, or in the other direction lack, for whoever uses them."""
    applied = is_applied(manifest)
    stays = "not applied" if applied else "not removed"
    cameras = manifest["config"]["cameras"]
    lines = []
    if bare := [name for name, camera in cameras.items() if camera["principal_distance"] is None]:
        lines.append(
            f"The principal distance of {', '.join(bare)} changes with the air in the lens (130 to "
            f"310 ppm at 6 km on a 153 mm lens, as much as refraction itself): {stays}."
        )
    if behind := [name for name, camera in cameras.items() if _glass_is_apart(camera["window"])]:
        lines.append(
            f"The glass before {', '.join(behind)} displaces rays, by 7 mm for 20 mm of glass at "
            f"45°: {stays}."
        )
    if not applied:
        lines += [
            "Earth curvature and map projection: adjust in earth-centred or one local "
            "east-north-up frame.",
            "Switch the refraction correction off in the adjustment: nothing may be corrected "
            "twice.",
        ]
    return lines


def _glass_is_apart(window: Mapping[str, Any] | None) -> bool:
    """Whether there is plane glass that the calibration was made without."""
    return window is not None and (window["shape"], window["in_calibration"]) == ("plane", "none")
