"""Independent truth for rays: Gyer's Eq. 11-12 with 30 to 40 digits, in the papers' own units."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import mpmath as mp
import pytest

RADIUS = 6_371_000


def us1976_gyer(h: mp.mpf) -> mp.mpf:
    """n - 1 of US 1976 up to 32 km' by Gyer's Eq. 13, from the constants of the definitions."""
    r0 = mp.mpf(6_356_766)
    gmr = mp.mpf("9.80665") * mp.mpf("28.9644") / mp.mpf("8314.32")
    H = r0 * h / (r0 + h)
    cold = mp.mpf("216.65")
    t0 = mp.mpf("288.15")
    lapse = mp.mpf("0.0065")
    at_11 = mp.mpf("1013.25") * (cold / t0) ** (gmr / lapse)
    if H <= 11_000:
        t = t0 - lapse * H
        p = mp.mpf("1013.25") * (t / t0) ** (gmr / lapse)
    elif H <= 20_000:
        t = cold
        p = at_11 * mp.exp(-gmr * (H - 11_000) / cold)
    else:
        at_20 = at_11 * mp.exp(-gmr * 9_000 / cold)
        t = cold + (H - 20_000) / 1000
        p = at_20 * (cold / t) ** (gmr * 1000)
    return mp.mpf("78.831e-6") * p / t


def us1976_kinks() -> list[mp.mpf]:
    """Heights [m] at which the layers of US 1976 meet."""
    r0 = mp.mpf(6_356_766)
    return [r0 * H / (r0 - H) for H in (11_000, 20_000)]


class Truth:
    """Refraction angles [arcsec] through US 1976 with Gyer's index."""

    index = staticmethod(us1976_gyer)

    def __init__(self, digits: int = 40) -> None:
        self.digits = digits

    def subtended(
        self, h_c: float, low: mp.mpf, high: mp.mpf, zeta: mp.mpf, grazing: bool
    ) -> mp.mpf:
        """Angle at the centre of the earth, Eq. 12."""
        k = (1 + us1976_gyer(mp.mpf(h_c))) * (RADIUS + mp.mpf(h_c)) * mp.sin(zeta)

        def integrand(h):
            r = RADIUS + h
            return mp.re(k / (r * mp.sqrt(((1 + us1976_gyer(h)) * r) ** 2 - k**2)))

        kinks = [b for b in us1976_kinks() if low < b < high]
        if not grazing:
            return mp.quad(integrand, [low, *kinks, high], method="gauss-legendre")
        # h = low + s^2, with intervals that shrink towards the singularity at or near s = 0.
        end = mp.sqrt(high - low)
        points = [0, *(mp.sqrt(b - low) for b in kinks), *(end / 4**j for j in range(10))]
        return mp.quad(
            lambda s: 2 * s * integrand(low + s * s), sorted(set(points)), method="gauss-legendre"
        )

    def chord(self, h_c: float, h_g: float, zeta: mp.mpf, theta: mp.mpf) -> float:
        """R_c [arcsec] from the subtended angle, Eq. 10: the direction of the chord."""
        r_c = RADIUS + mp.mpf(h_c)
        r_g = RADIUS + mp.mpf(h_g)
        straight = mp.atan2(r_g * mp.sin(theta), r_c - r_g * mp.cos(theta))
        return float((zeta - straight) * 648_000 / mp.pi)

    def angle(self, h_c: float, h_g: float, zeta_c: float, *, grazing: bool = False) -> float:
        """R_c of a ray that does not turn on its way, up or down."""
        with mp.workdps(self.digits):
            low, high = sorted((mp.mpf(h_c), mp.mpf(h_g)))
            zeta = mp.mpf(zeta_c)
            return self.chord(h_c, h_g, zeta, self.subtended(h_c, low, high, zeta, grazing))

    def turning_height(self, h_c: float, zeta_c: float) -> mp.mpf:
        """h_90 [m] below the camera (Eq. 16)."""
        with mp.workdps(self.digits):
            r_c = RADIUS + mp.mpf(h_c)
            k = (1 + us1976_gyer(mp.mpf(h_c))) * r_c * mp.sin(mp.mpf(zeta_c))

            h = mp.mpf(h_c)
            for _ in range(60):  # n r grows by 0.75 to 1 per metre: each step gains a digit
                h -= ((1 + us1976_gyer(h)) * (RADIUS + h) - k) / mp.mpf("0.9")
            return h

    def through_lowest_point(self, h_c: float, h_g: float, zeta_c: float) -> float:
        """R_c of a ray down through P_90 and up to a target above the camera (Eq. 15)."""
        with mp.workdps(self.digits):
            zeta = mp.mpf(zeta_c)
            turn = self.turning_height(h_c, zeta_c)
            theta = 2 * self.subtended(h_c, turn, mp.mpf(h_c), zeta, True)
            theta += self.subtended(h_c, mp.mpf(h_c), mp.mpf(h_g), zeta, True)
            return self.chord(h_c, h_g, zeta, theta)


@pytest.fixture(scope="session")
def truth() -> Callable[[int], Truth]:
    return Truth


@pytest.fixture(scope="session")
def airs() -> ModuleType:
    """Air with a covariance; tests are imported by path, and so is what they share."""
    place = Path(__file__).with_name("uncertain_air.py")
    spec = importlib.util.spec_from_file_location("uncertain_air", place)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
