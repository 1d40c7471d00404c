"""Exposures of a level camera at some heights, and what its rays meet there."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.helpers import channel
from unbend.atmosphere import standard_atmosphere
from unbend.flight.exposures import Events
from unbend.flight.heights import HeightSystem
from unbend.flight.mount import Mount
from unbend.flight.station_builder import build_stations
from unbend.messages import Ledger
from unbend.refraction.window import Cabin
from unbend.stages.cabin_air import with_cabin_air
from unbend.stages.exposure_setup import exposures_of

SECONDS = np.arange(0.0, 10.0, 0.1)
US1976 = standard_atmosphere("us1976")
LEVEL = (0.0, 0.0, 0.0)
AT_REST = Mount()
WARM_HATCH = Cabin(
    "opening",
    warmer_k=10.0,
    excess_pa=0.0,
    sigma_pressure_pa=0.0,
    sigma_temperature_k=5.0,
)


def attitude_channel(yaw, pitch, roll, *, name="ATT", seconds=SECONDS):
    """A channel of one attitude [deg]."""
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)
    x, y, z, w = rotation.as_quat()
    return channel(name, seconds, q_w=w, q_x=x, q_y=y, q_z=z)


def stations(
    *heights_m,
    camera="nadir",
    attitude=LEVEL,
    mount=AT_REST,
    aircraft=None,
    **columns,
):
    """One exposure a height, the camera level and to the north; with values of some columns."""
    count = len(heights_m)
    place = {"lat_rad": 0.8, "lon_rad": 0.1}
    roles = {
        "position": channel("POS", SECONDS, **place),
        "height": channel("GPS[0]", SECONDS, **place, h_msl_m=1000.0),
        "attitude": attitude_channel(*attitude),
    }
    if aircraft is not None:
        roles["aircraft_attitude"] = aircraft
    names = [f"{camera}_{i}" for i in range(count)]
    time_ns = np.full(count, 5 * 10**9)
    events = Events(camera, np.array(names, dtype=object), time_ns)
    built = build_stations(events, roles, mount, HeightSystem(), 1.0)
    assert built.ok.all()
    for name, values in columns.items():
        values = np.asarray(values, float)
        columns[name] = np.resize(values, count)
    return replace(built, h_msl_m=np.array(heights_m), **columns)


def look(exposed, window=None, lens=None, profile=US1976):
    """Exposures and ledger of the camera ``nadir``, which may have a window and a lens in air."""
    ledger = Ledger()
    windows = {}
    lenses = {}
    if window is not None:
        windows["nadir"] = window
    if lens is not None:
        lenses["nadir"] = lens
    with_air = with_cabin_air(exposed, windows, lenses, profile, ledger)
    exposures = exposures_of(
        with_air,
        profile,
        windows,
        lenses,
        ledger,
        radius_m=6_378_000.0,
    )
    return exposures, ledger
