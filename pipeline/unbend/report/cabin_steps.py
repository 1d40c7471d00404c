"""What to measure or to state of the air in cabins, so that a run corrects better."""

from collections.abc import Iterable, Mapping

from unbend.refraction.window import SIGMA_BAROMETER_PA, SIGMA_THERMOMETER_K
from unbend.tables.manifest.sections import CabinKeys
from unbend.tables.manifest.whole import Manifest
from unbend.units import HECTOPASCAL

OF_USUAL_CABINS = ("CABIN-BOARD", "CABIN-TEMPERATURE")
"""Codes of messages that usual air is assumed in a cabin."""


def cabin_step(manifest: Manifest) -> str:
    """Which air in the cabins to measure, or which of the errors assumed of it to state."""
    cabins = {}
    openings = []
    for name, camera in manifest.sections.cameras.items():
        if camera.opening is not None:
            openings.append(f"cameras.{name}.opening")
        if camera.window is not None and camera.window.shape == "plane":
            cabins[name] = camera.window.cabin
    if not cabins and openings:
        return f"Measure the air in front of the lens, and state it: {', '.join(openings)}."
    usual = usual_cabins(manifest, cabins)
    if usual:
        return f"Measure the air in the cabin, or state it: {keys_of_cabins(usual)}."
    return step_to_measured_cabins(cabins)


def usual_cabins(manifest: Manifest, cabins: Mapping[str, CabinKeys | str | None]) -> list[str]:
    """The cameras in whose cabin the usual air is assumed, as none is stated or known."""
    ledger = manifest.results.ledger
    places = [entry.where for entry in ledger if entry.code in OF_USUAL_CABINS]
    names = []
    for name, cabin in cabins.items():
        if cabin == "standard_schedule" or f"camera {name}" in places:
            names.append(name)
    return names


def keys_of_cabins(names: Iterable[str]) -> str:
    """The keys of the mission file that state the air in some cabins."""
    return ", ".join(f"cameras.{name}.window.cabin" for name in names)


def step_to_measured_cabins(cabins: Mapping[str, CabinKeys | str | None]) -> str:
    """What to state of cabins whose air is measured: the sigmas that were assumed of sensors."""
    keys = keys_of_cabins(cabins)
    assumed = {}
    if any(is_pressure_sigma_assumed(cabin) for cabin in cabins.values()):
        assumed["sigma_pressure_hpa"] = f"{SIGMA_BAROMETER_PA / HECTOPASCAL:g} hPa"
    if any(is_temperature_sigma_assumed(cabin) for cabin in cabins.values()):
        assumed["sigma_temperature_k"] = f"{SIGMA_THERMOMETER_K:g} K"
    if not assumed:
        return (
            "For a better correction, measure the air in the cabin more accurately than stated: "
            f"{keys}."
        )
    return (
        f"The sigma of the sensors in the cabin is assumed to be {', '.join(assumed.values())}. If "
        f"it is smaller, give {', '.join(assumed)} ({keys})."
    )


def step_to_stated_sigmas(manifest: Manifest) -> list[str]:
    """To state the sigmas of numbers for the air in cabins, if these may err by more than the air.

    So they may where the window moves points by more than the air's sigma. Without a sigma of the
    air nothing is said.
    """
    air = manifest.results.uncertainty
    if air is None:
        return []
    correction = manifest.results.correction
    missing = []
    for name, camera in manifest.sections.cameras.items():
        window = camera.window
        if window is None or window.shape != "plane" or not isinstance(window.cabin, CabinKeys):
            continue
        of_camera = correction.cameras.get(name, correction)
        by_window = of_camera.window_arcsec.median or 0.0
        by_air = of_camera.refraction_arcsec.median or 0.0
        if by_window > air.scale_sigma * by_air:
            keys = sigmas_not_stated(window.cabin)
            if keys:
                missing.append(f"cameras.{name}.window.cabin: {', '.join(keys)}")
    if not missing:
        return []
    places = "; ".join(missing)
    return [
        f"State the sigmas of the air in the cabin ({places}): the sigmas of the results do not "
        "contain the errors of these numbers."
    ]


def sigmas_not_stated(cabin: CabinKeys) -> list[str]:
    """The keys for the sigmas of the numbers that are stated without one."""
    keys = []
    if cabin.pressure not in ("log", "ambient") and cabin.sigma_pressure_hpa is None:
        keys.append("sigma_pressure_hpa")
    is_number = cabin.temperature_c not in ("log", None)
    if is_number and cabin.sigma_temperature_k is None:
        keys.append("sigma_temperature_k")
    return keys


def is_pressure_sigma_assumed(cabin: CabinKeys | str | None) -> bool:
    """Whether a sensor measures the pressure in a cabin, and its sigma is not stated."""
    if not isinstance(cabin, CabinKeys):
        return cabin == "log"
    return cabin.pressure in ("log", "ambient") and cabin.sigma_pressure_hpa is None


def is_temperature_sigma_assumed(cabin: CabinKeys | str | None) -> bool:
    """Whether a sensor measures the temperature in a cabin, and its sigma is not stated."""
    if not isinstance(cabin, CabinKeys):
        return cabin == "log"
    return cabin.temperature_c in ("log", None) and cabin.sigma_temperature_k is None
