"""Sentences on the air in lenses: what it leaves in the coordinates, and what is uncertain."""

from collections.abc import Iterable, Mapping

from unbend.report.words import length, pixels, with_sigma
from unbend.tables.manifest.results import CameraAirRecord, ResultsRecord

SMALLEST_MEASURABLE_PX = 0.05
"""A correction that stays below it everywhere cannot be seen in image measurements."""


def lens_left_in(results: ResultsRecord) -> str:
    """What the air in lenses leaves in the coordinates, in a sentence.

    Empty where the mission file states the air of the calibration, and where nobody can measure it.
    """
    left = uncorrected_lenses(results)
    if not left:
        return ""
    largest = max(left.values(), key=lambda lens: abs(lens.lens_ppm))
    size = with_sigma(abs(largest.lens_ppm), largest.lens_sigma_ppm)
    of_height = ""
    if largest.lens_height_m is not None:
        of_height = f", {length(largest.lens_height_m)} of height"
    if any(not lens.calibrated_in_flight for lens in left.values()):
        since = "compared with a calibration at 20 °C and 1013 hPa"
    else:
        since = "unless the calibration was flown at this height"
    return (
        f"Not corrected for the air in the lens of {', '.join(left)}: about {size} ppm of the "
        f"principal distance{of_height}, {since}."
    )


def uncorrected_lenses(results: ResultsRecord) -> dict[str, CameraAirRecord]:
    """The cameras whose air in the lens is not removed, where that can be measured."""
    left = {}
    for name, camera in results.air_at_cameras.items():
        if not camera.lens_removed and camera.lens_edge_px >= SMALLEST_MEASURABLE_PX:
            left[name] = camera
    return left


def reference_step(left: Mapping[str, CameraAirRecord]) -> str:
    """What to state of lenses that are not corrected for the air in them."""
    keys = ", ".join(f"cameras.{name}" for name in left)
    step = (
        "State the air of the calibration, to remove the effect of the air in the lens: "
        f"principal_distance: {{reference: {{pressure_hpa, temperature_c}}}} ({keys})."
    )
    if any(lens.calibrated_in_flight for lens in left.values()):
        step += " For a calibration in flight, that is the air in the lens during its flight."
    return step


def typical_lenses(results: ResultsRecord) -> dict[str, CameraAirRecord]:
    """The cameras whose air in the lens is removed as that of a typical lens, of some sigma."""
    typical = {}
    for name, camera in results.air_at_cameras.items():
        if camera.lens_removed and camera.lens_sigma_ppm:
            typical[name] = camera
    return typical


def limits_of_lenses(results: ResultsRecord) -> list[tuple[str, str]]:
    """What lenses that are corrected as typical ones leave uncertain, where it can be measured."""
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
    """The standard deviation [px] of the lens's effect at the edge of the image."""
    if not camera.lens_ppm or camera.lens_sigma_ppm is None:
        return 0.0
    return camera.lens_edge_px * camera.lens_sigma_ppm / abs(camera.lens_ppm)


def lens_step(lenses: Iterable[str]) -> str:
    """What to state of lenses that are corrected as typical ones, whose part is the largest."""
    keys = ", ".join(f"cameras.{name}.principal_distance" for name in lenses)
    return (
        "If the change of the lens by the air was measured, state dc_dp_px_per_hpa and "
        f"dc_dt_px_per_k ({keys})."
    )
