"""Independent truth for rays: Gyer's Eq. 11-12 with 30 to 40 digits, in the papers' own units."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

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


@dataclass(frozen=True)
class Crossing:
    """Where a ray reaches a height: its refraction angle [rad], and how far away [m]."""

    r_c: mp.mpf
    distance: mp.mpf

    @property
    def r_c_arcsec(self) -> float:
        return float(self.r_c * 648_000 / mp.pi)

    @property
    def distance_m(self) -> float:
        return float(self.distance)


class Truth:
    """Rays through US 1976 with Gyer's index, or with so many times the pressure."""

    def __init__(self, digits: int = 40, pressure_ratio: mp.mpf | int = 1) -> None:
        self.digits = digits
        self.pressure_ratio = pressure_ratio

    def n_r(self, h: mp.mpf) -> mp.mpf:
        return (1 + self.pressure_ratio * us1976_gyer(h)) * (RADIUS + h)

    def subtended(
        self, h_c: mp.mpf, low: mp.mpf, high: mp.mpf, zeta: mp.mpf, grazing: bool
    ) -> mp.mpf:
        """Angle at the centre of the earth, Eq. 12."""
        k = self.n_r(h_c) * mp.sin(zeta)

        def integrand(h):
            return mp.re(k / ((RADIUS + h) * mp.sqrt(self.n_r(h) ** 2 - k**2)))

        kinks = [b for b in us1976_kinks() if low < b < high]
        if not grazing:
            return mp.quad(integrand, [low, *kinks, high], method="gauss-legendre")

        def graded(s):
            return 2 * s * integrand(low + s * s)

        # h = low + s^2, with intervals that shrink towards the singularity at or near s = 0.
        end = mp.sqrt(high - low)
        points = {mp.mpf(0)}
        points.update(mp.sqrt(b - low) for b in kinks)
        points.update(end / 4**j for j in range(10))
        return mp.quad(graded, sorted(points), method="gauss-legendre")

    def chord(self, h_c: mp.mpf, h_g: mp.mpf, zeta: mp.mpf, theta: mp.mpf) -> Crossing:
        """The straight line under which a subtended angle is seen; R_c by Eq. 10."""
        r_c = RADIUS + h_c
        r_g = RADIUS + h_g
        straight = mp.atan2(r_g * mp.sin(theta), r_c - r_g * mp.cos(theta))
        square = (h_c - h_g) ** 2 + 4 * r_c * r_g * mp.sin(theta / 2) ** 2
        return Crossing(zeta - straight, mp.sqrt(square))

    def crossing(
        self,
        h_c: float,
        h_g: float,
        zeta_c: float,
        *,
        beyond: bool = False,
        grazing: bool | None = None,
    ) -> Crossing:
        """The crossing of a height before the ray's lowest point P_90, or beyond it (Eq. 15).

        ``grazing``: whether the ray is nearly level at its lower end; by default over 88 degrees.
        """
        with mp.workdps(self.digits):
            camera = mp.mpf(h_c)
            target = mp.mpf(h_g)
            zeta = mp.mpf(zeta_c)
            if beyond:
                turn = self.turning_height(h_c, zeta_c)
                theta = self.subtended(camera, turn, camera, zeta, True)
                theta += self.subtended(camera, turn, target, zeta, True)
            else:
                is_grazing = zeta_c > math.radians(88.0) if grazing is None else grazing
                low, high = sorted((camera, target))
                theta = self.subtended(camera, low, high, zeta, is_grazing)
            return self.chord(camera, target, zeta, theta)

    def angle(self, h_c: float, h_g: float, zeta_c: float, *, grazing: bool = False) -> float:
        """R_c [arcsec] of a ray that does not turn on its way, up or down."""
        return self.crossing(h_c, h_g, zeta_c, grazing=grazing).r_c_arcsec

    def through_lowest_point(self, h_c: float, h_g: float, zeta_c: float) -> float:
        """R_c [arcsec] of a ray down through P_90 and up to a target above the camera."""
        return self.crossing(h_c, h_g, zeta_c, beyond=True).r_c_arcsec

    def turning_height(self, h_c: float, zeta_c: float) -> mp.mpf:
        """h_90 [m] below the camera (Eq. 16)."""
        with mp.workdps(self.digits):
            h = mp.mpf(h_c)
            k = self.n_r(h) * mp.sin(mp.mpf(zeta_c))
            for _ in range(60):  # n r grows by 0.75 to 1 per metre: each step gains a digit
                h -= (self.n_r(h) - k) / mp.mpf("0.9")
            return h


@pytest.fixture(scope="session")
def truth() -> Callable[[int], Truth]:
    return Truth
