"""Sentences on the air in lenses: its effects on the coordinates, and their uncertainty."""

from collections.abc import Iterable, Mapping

from unbend.report.words import length, pixels, with_sigma
from unbend.tables.manifest.results import CameraAirRecord, ResultsRecord

SMALLEST_MEASURABLE_PX = 0.05
"""A correction that is smaller everywhere cannot be seen in image measurements."""


def lens_left_in(results: ResultsRecord) -> str:
    """A sentence on the effect of the air in lenses that is not corrected, with the largest size.

    Empty if it is corrected in all cameras, or too small to be measured.
    """
    lenses = uncorrected_lenses(results)
    if not lenses:
        return ""
    largest = max(lenses.values(), key=lambda lens: abs(lens.lens_ppm))
    size = with_sigma(abs(largest.lens_ppm), largest.lens_sigma_ppm)
    of_height = ""
    if largest.lens_height_m is not None:
        of_height = f", {length(largest.lens_height_m)} of height"
    if any(not lens.calibrated_in_flight for lens in lenses.values()):
        condition = "compared with a calibration at 20 °C and 1013 hPa"
    else:
        condition = "unless the calibration was flown at this height"
    return (
        f"Not corrected for the air in the lens of {', '.join(lenses)}: about {size} ppm of the "
        f"principal distance{of_height}, {condition}."
    )


def uncorrected_lenses(results: ResultsRecord) -> dict[str, CameraAirRecord]:
    """The cameras without a correction for the air in the lens, if its effect is measurable."""
    lenses = {}
    for name, camera in results.air_at_cameras.items():
        if not camera.lens_removed and camera.lens_edge_px >= SMALLEST_MEASURABLE_PX:
            lenses[name] = camera
    return lenses


def reference_step(lenses: Mapping[str, CameraAirRecord]) -> str:
    """The next step for uncorrected lenses: to state the air of their calibration."""
    keys = ", ".join(f"cameras.{name}" for name in lenses)
    step = (
        "State the air of the calibration, to remove the effect of the air in the lens: "
        f"principal_distance: {{reference: {{pressure_hpa, temperature_c}}}} ({keys})."
    )
    if any(lens.calibrated_in_flight for lens in lenses.values()):
        step += " For a calibration in flight, that is the air in the lens during its flight."
    return step


def typical_lenses(results: ResultsRecord) -> dict[str, CameraAirRecord]:
    """The cameras with a correction for the air in the lens as in a typical lens, with a sigma."""
    typical = {}
    for name, camera in results.air_at_cameras.items():
        if camera.lens_removed and camera.lens_sigma_ppm:
            typical[name] = camera
    return typical


def limits_of_lenses(results: ResultsRecord) -> list[tuple[str, str]]:
    """A sentence on the uncertainty of lenses corrected as typical ones, and a step against it.

    Empty without such lenses, or if the uncertainty is too small to be measured.
    """
    lenses = typical_lenses(results)
    if not lenses:
        return []
    largest = max(lenses.values(), key=_sigma_at_the_edge_px)
    if _sigma_at_the_edge_px(largest) < SMALLEST_MEASURABLE_PX:
        return []
    size = with_sigma(abs(largest.lens_ppm), largest.lens_sigma_ppm, "ppm")
    direction = "outward" if largest.lens_ppm < 0.0 else "inward"
    of_height = ""
    if largest.lens_height_m is not None:
        share = (largest.lens_sigma_ppm or 0.0) / abs(largest.lens_ppm)
        of_height = f"; its unknown part is {length(share * largest.lens_height_m)} of height"
    text = (
        f"The corrections contain the air in the lens of {', '.join(lenses)}, as in a typical "
        f"lens: {size} of the principal distance, {pixels(largest.lens_edge_px)} {direction} at "
        f"the edge of the image{of_height} (1 sigma)."
    )
    return [(text, lens_step(lenses))]


def _sigma_at_the_edge_px(camera: CameraAirRecord) -> float:
    """The standard deviation [px] of the lens's effect at the edge of the image; 0 if unknown."""
    if not camera.lens_ppm or camera.lens_sigma_ppm is None:
        return 0.0
    return camera.lens_edge_px * camera.lens_sigma_ppm / abs(camera.lens_ppm)


def lens_step(lenses: Iterable[str]) -> str:
    """The next step for lenses corrected as typical ones: to state their measured change."""
    keys = ", ".join(f"cameras.{name}.principal_distance" for name in lenses)
    return (
        "If the change of the lens by the air was measured, state dc_dp_px_per_hpa and "
        f"dc_dt_px_per_k ({keys})."
    )
