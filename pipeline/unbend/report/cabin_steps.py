"""Next steps for the air in cabins: what to measure or to state for a better correction."""

from collections.abc import Iterable, Mapping

from unbend.refraction.window import SIGMA_BAROMETER_PA, SIGMA_THERMOMETER_K
from unbend.tables.manifest.sections import CabinKeys
from unbend.tables.manifest.whole import Manifest
from unbend.units import HECTOPASCAL

CODES_OF_ASSUMED_AIR = ("CABIN-BOARD", "CABIN-TEMPERATURE")
"""Codes of messages that typical air is assumed in a cabin."""


def cabin_step(manifest: Manifest) -> str:
    """The step that improves the correction of the windows most, as a sentence.

    It is to measure the air, or to state the sigmas of the sensors that measure it.
    """
    cabins = {}  # name of a camera -> its cabin
    openings = []
    for name, camera in manifest.sections.cameras.items():
        if camera.opening is not None:
            openings.append(f"cameras.{name}.opening")
        if camera.window is not None and camera.window.shape == "plane":
            cabins[name] = camera.window.cabin
    if not cabins and openings:
        return f"Measure the air in front of the lens, and state it: {', '.join(openings)}."
    assumed = cameras_with_assumed_air(manifest, cabins)
    if assumed:
        return f"Measure the air in the cabin, or state it: {keys_of_cabins(assumed)}."
    return step_for_measured_cabins(cabins)


def cameras_with_assumed_air(
    manifest: Manifest, cabins: Mapping[str, CabinKeys | str | None]
) -> list[str]:
    """The cameras for which typical air in the cabin is assumed, because it is not known.

    ``cabins`` : name of a camera -> its cabin in the mission file.
    """
    ledger = manifest.results.ledger
    places = [entry.where for entry in ledger if entry.code in CODES_OF_ASSUMED_AIR]
    names = []
    for name, cabin in cabins.items():
        if cabin == "standard_schedule" or f"camera {name}" in places:
            names.append(name)
    return names


def keys_of_cabins(names: Iterable[str]) -> str:
    """The keys of the mission file for the cabins of cameras with these names."""
    return ", ".join(f"cameras.{name}.window.cabin" for name in names)


def step_for_measured_cabins(cabins: Mapping[str, CabinKeys | str | None]) -> str:
    """The step for cabins with sensors: state sigmas that are assumed, or measure better.

    ``cabins`` : name of a camera -> its cabin in the mission file.
    """
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
    """A step to state the sigmas of numbers for the air in cabins; empty if they matter little.

    They matter if the window moves points by more than the sigma of the air outside does. Without a
    sigma of that air the list is empty.
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
        shifts = correction.cameras.get(name, correction)
        by_window_arcsec = shifts.window_arcsec.median or 0.0
        by_air_arcsec = shifts.refraction_arcsec.median or 0.0
        if by_window_arcsec > air.scale_sigma * by_air_arcsec:
            keys = missing_sigmas(window.cabin)
            if keys:
                missing.append(f"cameras.{name}.window.cabin: {', '.join(keys)}")
    if not missing:
        return []
    places = "; ".join(missing)
    return [
        f"State the sigmas of the air in the cabin ({places}): the sigmas of the results do not "
        "contain the errors of these numbers."
    ]


def missing_sigmas(cabin: CabinKeys) -> list[str]:
    """The keys of sigmas that are missing for the numbers that a mission file states of a cabin."""
    keys = []
    is_pressure_number = cabin.pressure not in ("log", "ambient")
    if is_pressure_number and cabin.sigma_pressure_hpa is None:
        keys.append("sigma_pressure_hpa")
    is_temperature_number = cabin.temperature_c not in ("log", None)
    if is_temperature_number and cabin.sigma_temperature_k is None:
        keys.append("sigma_temperature_k")
    return keys


def is_pressure_sigma_assumed(cabin: CabinKeys | str | None) -> bool:
    """Whether a sensor measures the pressure in a cabin, and its sigma is not stated.

    ``cabin`` is a record of keys, or a single word such as ``log``.
    """
    if not isinstance(cabin, CabinKeys):
        return cabin == "log"
    return cabin.pressure in ("log", "ambient") and cabin.sigma_pressure_hpa is None


def is_temperature_sigma_assumed(cabin: CabinKeys | str | None) -> bool:
    """Whether a sensor measures the temperature in a cabin, and its sigma is not stated.

    ``cabin`` is a record of keys, or a single word such as ``log``.
    """
    if not isinstance(cabin, CabinKeys):
        return cabin == "log"
    return cabin.temperature_c in ("log", None) and cabin.sigma_temperature_k is None
