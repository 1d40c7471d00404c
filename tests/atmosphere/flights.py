"""Flights through real air: soundings integrated as truth, and what imperfect sensors make of it.

Nothing here is shared with the estimator: WGS84 normal gravity, moist hydrostatics on a grid of
metres, Edlen's index and Sonntag's saturation pressure (unbend.simulate), Gyer's Eq. 24 in the
first order; the sensors are differential equations and random walks in time.
"""

import copy
import math
import re
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from numpy import ndarray
from scipy.integrate import cumulative_simpson, trapezoid
from scipy.signal import lfilter

from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.rejection import Reason, reasons_where
from unbend.simulate.true_air import edlen_index, normal_gravity, saturation_pressure_pa

TESTS = Path(__file__).resolve().parents[1]
DATA = TESTS / "data"
SHARED_SOUNDINGS = TESTS.parents[1] / "shared" / "soundings"
TAKEOFF_S = 30.0
CRUISE_S = 300.0
RAMP_S = 1380.0  # 23 minutes, in which a pressure ramp reaches its size
HOUR_NS = 3.6e12
AIR = ("t", "p", "rh")
"""What sensors measure of a `Truth`, by the names of its arrays."""


@dataclass(frozen=True)
class Balloon:
    """Levels of a balloon: geopotential [m'], T [K], e [Pa]; pressure [Pa] at the first; when in
    the year and the day it rose, and at which longitude [rad]."""

    name: str
    latitude: float
    H: ndarray
    t: ndarray
    e: ndarray
    p0: float
    month: int = 6
    utc_hour: float = 12.0
    longitude: float = 0.0


EXTREMES = {
    ("arctic night, inversion of 15 K", 72.0, 1, 0.0): (
        "0 238 0.8, 150 246 0.8, 700 253 0.8, 2000 250 0.8, 9000 214 0.8, 11000 212 0.8"
    ),
    ("desert noon, adiabatic to 4 km", 25.0, 7, 12.0): "0 315 0.1, 4000 276 0.5, 11000 228 0.2",
    ("monsoon", 20.0, 7, 14.0): "0 303 0.9, 5000 275.5 0.9, 11000 233 0.6",
    ("trade wind inversion of 6 K at 1.6 km", 18.0, 3, 12.0): (
        "0 299 0.75, 600 293.2 0.9, 1600 287 0.9, 1850 293 0.15, 11000 238 0.1"
    ),
    ("clear night, 9 K in 250 m", 47.0, 10, 2.0): (
        "0 277 0.95, 250 286 0.6, 900 284 0.5, 3000 270 0.3, 11000 217 0.2"
    ),
}
"""Name, latitude [deg], month and hour (UTC): m', K and relative humidity at the ends of lines."""


def extremes():
    """Air made of straight lines: what nine soundings lack."""
    H = np.arange(0.0, 11_000.0, 25.0)
    balloons = []
    for (name, degrees, month, hour), ends in EXTREMES.items():
        rows = [end.split() for end in ends.split(",")]
        h, t, rh = np.array(rows, float).T
        t_k = np.interp(H, h, t)
        e = np.interp(H, h, rh) * saturation_pressure_pa(t_k)
        balloon = Balloon(
            name,
            math.radians(degrees),
            H,
            t_k,
            np.maximum(e, 1e-3),
            p0=101_000.0,
            month=month,
            utc_hour=hour,
        )
        balloons.append(balloon)
    return balloons


def geopotential(latitude, h):
    """Geopotential height [m'] of heights [m]; Simpson is exact for gravity to second order."""
    h = np.asarray(h, float)
    gravity = np.vectorize(partial(normal_gravity, latitude))
    weighted_sum = gravity(0.0) + 4.0 * gravity(0.5 * h) + gravity(h)
    return h * weighted_sum / 6 / 9.80665


class Truth:
    """The air of a balloon every metre, integrated; ``h`` above sea level from its first level."""

    def __init__(self, balloon, reach=10_500.0):
        self.name = balloon.name
        self.latitude = balloon.latitude
        self.longitude = balloon.longitude
        day = np.datetime64(f"2020-{balloon.month:02d}-15", "ns")
        midnight_ns = int(day.astype(np.int64))
        self.start_ns = midnight_ns + round(balloon.utc_hour * HOUR_NS)
        gravity = normal_gravity(self.latitude, 0.0)
        self.ground_m = float(balloon.H[0]) * 9.80665 / gravity
        self.above = np.arange(0.0, reach)
        self.h = self.ground_m + self.above
        self.H = geopotential(self.latitude, self.h)
        self.t = np.interp(self.H, balloon.H, balloon.t)
        log_e = np.interp(self.H, balloon.H, np.log(balloon.e))
        self.e = np.exp(log_e)
        self.p0 = balloon.p0
        self._weigh()

    def _weigh(self):
        """Pressure, relative humidity and refractivity of temperature and vapour pressure."""
        p = np.full(self.H.size, self.p0)
        for _ in range(4):  # the vapour's share of the weight, settled against pressure
            virtual = self.t / (1.0 - 0.378 * self.e / p)
            per_m = 9.80665 * 28.9644 / 8314.32 / virtual
            fall = cumulative_simpson(per_m, x=self.H, initial=0.0)
            p = self.p0 * np.exp(-fall)
        self.p = p
        saturated = saturation_pressure_pa(self.t)
        self.rh = np.minimum(self.e / saturated, 1.0)
        self.refractivity = edlen_index(p, self.t, self.e) - 1.0

    @property
    def hour(self):
        """Mean local time [h] of the flight's start."""
        utc = self.start_ns / HOUR_NS
        return (utc + math.degrees(self.longitude) / 15.0) % 24.0

    def over_hot_ground(self, rng):
        """The same with its lowest metres in the sun: warmer by 0.5 to 4 K, falling by 1/e in 10 to
        40 m (similarity theory has 1 to 3 K between 2 and 50 m on a sunny day)."""
        hot = copy.copy(self)
        warmer = rng.uniform(0.5, 4.0)
        depth = rng.uniform(10.0, 40.0)
        hot.t = self.t + warmer * np.exp(-self.above / depth)
        hot._weigh()
        return hot

    def at_height(self, values, above_ground):
        return np.interp(above_ground, self.above, values)

    def at_pressure(self, values, p):
        """Between the metres linear in ln p."""
        return np.interp(-np.log(p), -np.log(self.p), values)

    def r_plane(self, refractivity, climb):
        """R / tan(zeta) in the plane: the integral of (N - N_c) dh over h_c - h_g (Gyer Eq. 24)."""
        n = refractivity[: round(climb) + 1]
        return float(trapezoid(n - n[-1]) / climb)

    def error(self, profile, climb):
        """Relative error of R that a profile leaves, from the ground to the top of the climb."""
        h = self.h[: round(climb) + 1]
        right = self.r_plane(self.refractivity, climb)
        return self.r_plane(profile.refractivity(h), climb) / right - 1.0


def balloons():
    """Nine ascents of five sites: the numbers of ``tests/data/soundings``, with their sources.

    Levels in the order of height, one at a height; dew points filled in where they are given.
    """
    return [balloon_of_file(path) for path in sorted((DATA / "soundings").glob("*.csv"))]


def balloon_of_file(path):
    lines = path.read_text(encoding="ascii").splitlines()
    head = [line[2:] for line in lines if line.startswith("#")]
    about = dict(line.split(": ", 1) for line in head)
    latitude_deg = float(about["latitude_deg"])
    longitude_deg = float(about["longitude_deg"])
    time = re.search(r"(\d\d)(?::(\d\d))?Z?(?: UTC)?$", about["station"])
    hours = int(time[1])
    minutes = int(time[2] or 0)

    levels = pd.read_csv(path, comment="#")
    levels = levels.dropna(subset=["pressure_hpa", "geopotential_m", "temperature_c"])
    highest_below = levels.geopotential_m.cummax().shift()
    falls = levels.geopotential_m <= highest_below + 1.0
    levels = levels[~falls]
    H = levels.geopotential_m.to_numpy(float)
    moist = levels.dropna(subset="dew_point_c")
    dew_k = np.interp(H, moist.geopotential_m, moist.dew_point_c) + 273.15
    return Balloon(
        path.stem,
        math.radians(latitude_deg),
        H,
        levels.temperature_c.to_numpy(float) + 273.15,
        saturation_pressure_pa(np.maximum(dew_k, 190.0)),
        100.0 * float(levels.pressure_hpa.iloc[0]),
        month=int(about["month"]),
        utc_hour=hours + minutes / 60.0,
        longitude=math.radians(longitude_deg),
    )


@dataclass(frozen=True)
class Sensors:
    """What is wrong with the sensors; the default is nothing. Drifts are one-sigma of a walk,
    ``pressure_ramp_pa`` a drift that grows evenly, by so much in 23 minutes."""

    bias_k: float = 0.0
    transient_k: float = 0.0
    transient_s: float = 60.0
    lag_s: float = 0.0
    noise_k: float = 0.0
    drift_k: float = 0.0
    outliers: float = 0.0
    outlier_k: float = 15.0
    pressure_offset_pa: float = 0.0
    pressure_drift_pa: float = 0.0
    pressure_ramp_pa: float = 0.0
    pressure_noise_pa: float = 0.0
    pressure_scale: float = 0.0
    gnss_offset_m: float = 0.0
    gnss_drift_m: float = 0.0
    gnss_noise_m: float = 0.0
    humidity_bias: float = 0.0
    humidity_noise: float = 0.0


REALISTIC = Sensors(
    bias_k=3.0,
    transient_k=5.0,
    lag_s=20.0,
    noise_k=0.2,
    outliers=0.03,
    pressure_offset_pa=30.0,
    pressure_drift_pa=10.0,
    pressure_noise_pa=5.0,
    gnss_offset_m=2.0,
    gnss_drift_m=1.5,
    gnss_noise_m=0.3,
    humidity_bias=0.03,
    humidity_noise=0.02,
)


def drawn(rng):
    """Sensors as bad as the realistic ones are, each in its own way.

    A static pressure loses some 0.2 % of its change: half of what a data sheet allows.
    """
    return replace(
        REALISTIC,
        bias_k=rng.normal(0.0, 2.0),
        transient_k=rng.normal(0.0, 4.0),
        transient_s=60.0 * math.exp(rng.normal(0.0, 0.3)),
        lag_s=rng.uniform(1.0, 25.0),
        drift_k=0.3,
        pressure_offset_pa=rng.normal(0.0, 40.0),
        pressure_drift_pa=15.0,
        gnss_offset_m=rng.normal(0.0, 2.0),
        humidity_bias=rng.normal(0.0, 0.03),
        pressure_scale=rng.spawn(1)[0].normal(0.0, 0.002),
    )


def with_any_static(sensors, rng):
    """The same, of which one in ten has a static pressure that loses some per cent."""
    other = rng.spawn(1)[0]
    lost = other.normal(0.0, 0.03)
    if other.random() < 0.1:
        return replace(sensors, pressure_scale=lost)
    return sensors


def surveyed(rng):
    """The same with heights of a survey receiver, processed afterwards, and a quiet barometer.

    Heights to 5 cm; pressure with 2 Pa of noise (MS5611, data sheet: 1.2 to 2.7 Pa) and a slow
    drift, of which 0.5 hPa in 23 minutes is not rare. A log of an autopilot in `../shared/logs`
    has 0.1 m between heights and pressures a second apart and 0.4 m in half a minute, another, with
    a receiver of 2013, 0.4 m, 2.4 m, and 6 m in a quarter of an hour; `drawn` has 0.6, 0.7, 2 m.
    """
    return replace(
        drawn(rng),
        pressure_noise_pa=2.0,
        pressure_drift_pa=4.0,
        pressure_ramp_pa=rng.normal(0.0, 30.0),
        gnss_noise_m=0.03,
        gnss_drift_m=0.05,
        gnss_offset_m=rng.normal(0.0, 0.1),
    )


def walk(rng, seconds, tau):
    """A stationary first-order Gauss-Markov process of unit variance at even times."""
    step_s = seconds[1] - seconds[0]
    keep = math.exp(-step_s / tau)
    kicks = rng.normal(size=seconds.size)
    kicks *= math.sqrt(1.0 - keep * keep)
    kicks[0] = rng.normal()
    return lfilter([1.0], [1.0, -keep], kicks)


def lagging(values, keep):
    """What follows values by a first-order lag, of which a step keeps this share; settled first."""
    settled = [keep * values[0]]
    felt, _ = lfilter([1.0 - keep], [1.0, -keep], values, zi=settled)
    return felt


def path(climb, rate, cruise_s, descent):
    """Seconds and heights above ground: standing, climbing, cruising, coming down."""
    up = TAKEOFF_S + climb / rate
    times = [0.0, TAKEOFF_S, up, up + cruise_s]
    heights = [0.0, 0.0, climb, climb]
    if descent:
        times.append(times[-1] + climb / rate)
        heights.append(0.0)
    seconds = np.arange(0.0, times[-1])
    return seconds, np.interp(seconds, times, heights)


def fly(
    truth,
    climb,
    sensors,
    rng,
    *,
    thermometer=True,
    barometer=True,
    humidity="surface",
    rate=5.0,
    cruise_s=CRUISE_S,
    descent=False,
    gate_s=120.0,
):
    """What a flight measures. ``humidity``: none | surface (the lowest 200 m) | profile."""
    seconds, above = path(climb, rate, cruise_s, descent)
    along = {name: truth.at_height(getattr(truth, name), above) for name in AIR}
    samples = measure(
        truth,
        along,
        seconds,
        above,
        sensors,
        rng,
        gate_s,
    )
    measured = {}
    if thermometer:
        measured["temperature"] = samples.temperature
    if barometer:
        measured["pressure"] = samples.pressure
    if humidity == "profile":
        measured["humidity"] = samples.humidity
    if humidity == "surface":
        too_high = reasons_where(above >= 200.0, Reason.GROUND_SOAK)
        measured["humidity"] = replace(samples.humidity, rejected=too_high)
    return AirSamples(**measured)


def measure(
    truth,
    along,
    seconds,
    above,
    sensors,
    rng,
    gate_s,
):
    """What the sensors make of the air ``along`` a way (t, p, rh), from the ground of ``truth``."""

    def noise(sigma):
        return sigma * rng.normal(0.0, 1.0, seconds.size)

    def drift(sigma, tau_s):
        return sigma * walk(rng, seconds, tau_s)

    s = sensors
    step_s = seconds[1] - seconds[0]
    felt = along["t"]
    if s.lag_s > 0.0:
        felt = lagging(felt, keep=math.exp(-step_s / s.lag_s))
    since_takeoff_s = np.maximum(seconds - TAKEOFF_S, 0.0)
    t = felt + s.bias_k
    t += s.transient_k * np.exp(-since_takeoff_s / s.transient_s)
    t += noise(s.noise_k)
    t += drift(s.drift_k, 600.0)
    t[rng.random(seconds.size) < s.outliers] += s.outlier_k
    p = along["p"] + s.pressure_offset_pa
    p += s.pressure_scale * (truth.p0 - along["p"])
    p += drift(s.pressure_drift_pa, 1200.0)
    p += s.pressure_ramp_pa * seconds / RAMP_S
    p += noise(s.pressure_noise_pa)
    h = truth.ground_m + above + s.gnss_offset_m
    h += drift(s.gnss_drift_m, 900.0)
    h += noise(s.gnss_noise_m)
    rh = along["rh"] + s.humidity_bias + noise(s.humidity_noise)
    time_ns = truth.start_ns + np.round(seconds * 1e9).astype(np.int64)
    gated = reasons_where(seconds - TAKEOFF_S < gate_s, Reason.GROUND_SOAK)
    thermometer = SensorSamples(time_ns, h, t, gated, "thermometer")
    barometer = SensorSamples(time_ns, h, p, name="barometer")
    hygrometer = SensorSamples(time_ns, h, rh, gated, "hygrometer")
    return AirSamples(thermometer, barometer, hygrometer)


def sun_on_the_probe(samples, rng):
    """The sun warms a thermometer: by 0 to 1.6 K always, less behind clouds (minutes apart) and on
    some headings (circles of 40 to 120 s), and by 0 to 8 K more on the ground."""
    t = samples.temperature
    seconds = (t.time_ns - t.time_ns[0]) * 1e-9
    most = rng.uniform(0.0, 2.0)
    soak = rng.uniform(0.0, 8.0)
    share = 0.8 + 0.2 * np.sign(walk(rng, seconds, 120.0))
    turns = seconds / rng.uniform(40.0, 120.0) + rng.random()
    heading = np.sin(2.0 * np.pi * turns)
    step_s = seconds[1] - seconds[0]
    keep = math.exp(-step_s / 10.0)  # the probe's own 10 s
    sun_k = most * (share + 0.3 * heading)
    warmer = lfilter([1.0 - keep], [1.0, -keep], sun_k)
    decay_s = 60.0 * math.exp(rng.normal(0.0, 0.3))
    since_takeoff_s = np.maximum(seconds - TAKEOFF_S, 0.0)
    warmer += soak * np.exp(-since_takeoff_s / decay_s)
    return replace(samples, temperature=replace(t, value=t.value + warmer))
