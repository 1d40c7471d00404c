"""The air of a flight at the wavelength of each camera."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from unbend.atmosphere import Profile
from unbend.atmosphere.refractive_index import INDEX_OF_ONE_LIGHT, IndexModel
from unbend.atmosphere.series.profile_series import ProfileSeries, TimedProfile
from unbend.stages import messages
from unbend.units import Mask, Names


def air_by_camera(
    air: ProfileSeries, cameras: Names, wavelengths_m: Mapping[str, float]
) -> ProfileSeries:
    """The profiles of a flight, each once for each wavelength of the cameras exposed in it.

    ``cameras`` (s,) names the camera of each station. ``wavelengths_m`` has wavelengths in vacuum
    [m] by camera; cameras without an entry keep the wavelength of the profiles. Refuses
    (MissionError WAVELENGTH-FORMULA) wavelengths if the formula of the refractive index is for one
    fixed wavelength.
    """
    if not wavelengths_m or not len(cameras):
        return air
    refuse_fixed_wavelength(air.index, f"cameras.{next(iter(wavelengths_m))}.wavelength_m")
    lights_m = sorted(set(wavelengths_m.values()))
    light_number = np.zeros(len(cameras), np.int64)  # 0: the wavelength of the profiles
    for name, wavelength_m in wavelengths_m.items():
        light_number[cameras == name] = 1 + lights_m.index(wavelength_m)

    # One number for each pair of profile and light; only the pairs in use become profiles.
    light_count = 1 + len(lights_m)
    pair_of_station = air.profile_number * light_count + light_number
    pairs, number_of_station = np.unique(pair_of_station, return_inverse=True)
    timed_profiles = []
    for pair in pairs.tolist():
        profile_number = pair // light_count
        light = pair % light_count
        timed = air.timed_profiles[profile_number]
        if light > 0:
            timed = in_light(timed, lights_m[light - 1])
        timed_profiles.append(timed)
    return ProfileSeries(
        timed_profiles=tuple(timed_profiles),
        profile_number=number_of_station.astype(np.int64),
    )


def refuse_fixed_wavelength(index: IndexModel, where: str) -> None:
    """Refuse (MissionError WAVELENGTH-FORMULA) an index formula that is for one fixed wavelength.

    ``where`` is the key or option that asks for another wavelength.
    """
    if index.name in INDEX_OF_ONE_LIGHT:
        raise messages.wavelength_of_formula(where=where, index=index.name)


def in_light(timed: TimedProfile, wavelength_m: float) -> TimedProfile:
    """The same air, with its refractivity and sigmas for another wavelength (in vacuum) [m]."""
    index = replace(timed.profile.index, wavelength_m=wavelength_m)
    profile = replace(timed.profile, index=index)
    covariance = timed.own_covariance
    if covariance is not None:
        lit_profile = replace(covariance.profile, index=index)
        covariance = replace(covariance, profile=lit_profile)
    return replace(
        timed,
        profile=profile,
        own_covariance=covariance,
    )


def index_of_rows(air: Profile | ProfileSeries, rows: Mask) -> IndexModel:
    """The formula of the refractive index, with its wavelength, at exposures of one camera.

    ``air`` is one profile, or the result of `air_by_camera`, in which all exposures of a camera
    have the same formula. ``rows`` is a mask (s,) of exposures of this camera, at least one.
    """
    if isinstance(air, Profile):
        return air.index
    first_exposure = int(np.argmax(rows))
    return air.profiles[int(air.profile_number[first_exposure])].index
