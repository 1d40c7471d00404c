"""The light of each camera: the air of a flight at the wavelengths that its cameras see."""

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
    """The profiles of a flight, each at the wavelengths of the cameras that were exposed in it.

    ``cameras`` (s,) are those of the stations. ``wavelengths_m`` in vacuum [m] are by camera;
    others keep the light of the profiles. Refuses (MissionError WAVELENGTH-FORMULA) wavelengths
    where the index of refraction is by a formula for one light.
    """
    if not wavelengths_m or not len(cameras):
        return air
    require_wavelengths(air.index, f"cameras.{next(iter(wavelengths_m))}.wavelength_m")
    lights_m = sorted(set(wavelengths_m.values()))
    light_number = np.zeros(len(cameras), np.int64)  # 0: the light of the profiles
    for name, wavelength_m in wavelengths_m.items():
        light_number[cameras == name] = 1 + lights_m.index(wavelength_m)

    # Each profile in each light that is needed there, numbered as a pair.
    choices = 1 + len(lights_m)
    pair_of_station = air.profile_number * choices + light_number
    pairs, number = np.unique(pair_of_station, return_inverse=True)
    timed_profiles = []
    for pair in pairs.tolist():
        profile_number = pair // choices
        light = pair % choices
        timed = air.timed_profiles[profile_number]
        if light > 0:
            timed = in_light(timed, lights_m[light - 1])
        timed_profiles.append(timed)
    return ProfileSeries(
        timed_profiles=tuple(timed_profiles),
        profile_number=number.astype(np.int64),
    )


def require_wavelengths(index: IndexModel, where: str) -> None:
    """Refuse (MissionError WAVELENGTH-FORMULA) a formula of the index that is for one light."""
    if index.name in INDEX_OF_ONE_LIGHT:
        raise messages.wavelength_of_formula(where=where, index=index.name)


def in_light(timed: TimedProfile, wavelength_m: float) -> TimedProfile:
    """The same air, with the refractivity and the sigmas at a wavelength in vacuum [m]."""
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
    """The formula of the refractive index, with its light, at some exposures of one camera.

    ``air`` is that of `air_by_camera`, in which all exposures of a camera have one light; ``rows``
    is a mask (s,) that holds at least one of them.
    """
    if isinstance(air, Profile):
        return air.index
    first = int(np.argmax(rows))
    return air.profiles[int(air.profile_number[first])].index
