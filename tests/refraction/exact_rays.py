"""Independent truth for rays: Gyer's Eq. 11-12 with 30 to 40 digits, in the papers' own units."""

import math
from dataclasses import dataclass

import mpmath as mp
import numpy as np

RADIUS = 6_371_000
EARTH = 6_356_766  # effective radius of US 1976 [m]


def us1976_gyer(h):
    """n - 1 of US 1976 up to 32 km' by Gyer's Eq. 13, from the constants of the definitions."""
    gravity = mp.mpf("9.80665")
    gmr = gravity * mp.mpf("28.9644") / mp.mpf("8314.32")
    H = EARTH * h / (EARTH + h)
    cold = mp.mpf("216.65")
    t0 = mp.mpf("288.15")
    lapse = mp.mpf("0.0065")
    p0 = mp.mpf("1013.25")
    at_11 = p0 * (cold / t0) ** (gmr / lapse)
    if H <= 11_000:
        t = t0 - lapse * H
        p = p0 * (t / t0) ** (gmr / lapse)
    elif H <= 20_000:
        t = cold
        p = at_11 * mp.exp(-gmr * (H - 11_000) / cold)
    else:
        at_20 = at_11 * mp.exp(-gmr * 9_000 / cold)
        t = cold + (H - 20_000) / 1000
        p = at_20 * (cold / t) ** (gmr * 1000)
    return mp.mpf("78.831e-6") * p / t


@dataclass(frozen=True)
class Crossing:
    """Where a ray reaches a height: its refraction angle [rad], and how far away [m]."""

    r_c: mp.mpf
    distance: mp.mpf

    @property
    def r_c_arcsec(self):
        return float(self.r_c * 648_000 / mp.pi)

    @property
    def distance_m(self):
        return float(self.distance)


class ExactRays:
    """Rays through US 1976 with Gyer's index, or with so many times the pressure."""

    def __init__(self, digits, pressure_ratio=1):
        self.digits = digits
        self.pressure_ratio = pressure_ratio

    def kinks(self):
        """Heights [m] at which layers meet."""
        return [mp.mpf(EARTH) * H / (EARTH - H) for H in (11_000, 20_000)]

    def n_r(self, h):
        return (1 + self.pressure_ratio * us1976_gyer(h)) * (RADIUS + h)

    def subtended(
        self,
        h_c,
        low,
        high,
        zeta,
        grazing,
    ):
        """Angle at the centre of the earth, Eq. 12."""
        k = self.n_r(h_c) * mp.sin(zeta)

        def integrand(h):
            square = self.n_r(h) ** 2 - k**2
            return mp.re(k / ((RADIUS + h) * mp.sqrt(square)))

        kinks = [h for h in self.kinks() if low < h < high]
        if not grazing:
            heights = [low, *kinks, high]
            return mp.quad(integrand, heights, method="gauss-legendre")

        def graded(s):
            return 2 * s * integrand(low + s * s)

        # h = low + s^2, with intervals that shrink towards the singularity at or near s = 0.
        end = mp.sqrt(high - low)
        points = [mp.mpf(0)]
        points += [mp.sqrt(h - low) for h in kinks]
        points += [end / 4**j for j in range(10)]
        return mp.quad(graded, sorted(points), method="gauss-legendre")

    def chord(self, h_c, h_g, zeta, theta):
        """The straight line under which a subtended angle is seen; R_c by Eq. 10."""
        r_c = RADIUS + h_c
        r_g = RADIUS + h_g
        across = r_g * mp.sin(theta)
        down = r_c - r_g * mp.cos(theta)
        straight = mp.atan2(across, down)
        square = (h_c - h_g) ** 2 + 4 * r_c * r_g * mp.sin(theta / 2) ** 2
        return Crossing(r_c=zeta - straight, distance=mp.sqrt(square))

    def crossing(
        self,
        h_c,
        h_g,
        zeta_c,
        *,
        beyond=False,
        grazing=None,
    ):
        """The crossing of a height before the ray's lowest point P_90, or beyond it (Eq. 15).

        ``grazing``: whether the ray is nearly level at its lower end; by default over 88 degrees.
        """
        with mp.workdps(self.digits):
            camera = mp.mpf(h_c)
            target = mp.mpf(h_g)
            zeta = mp.mpf(zeta_c)
            if beyond:
                turn = self.turning_height(h_c, zeta_c)
                legs = [(turn, camera), (turn, target)]
                grazing = True
            else:
                legs = [sorted((camera, target))]
            if grazing is None:
                grazing = zeta_c > math.radians(88.0)
            theta = mp.mpf(0)
            for low, high in legs:
                theta += self.subtended(camera, low, high, zeta, grazing)
            return self.chord(camera, target, zeta, theta)

    def angle(self, h_c, h_g, zeta_c, *, grazing=False):
        """R_c [arcsec] of a ray that does not turn on its way, up or down."""
        crossing = self.crossing(h_c, h_g, zeta_c, grazing=grazing)
        return crossing.r_c_arcsec

    def through_lowest_point(self, h_c, h_g, zeta_c):
        """R_c [arcsec] of a ray down through P_90 and up to a target above the camera."""
        crossing = self.crossing(h_c, h_g, zeta_c, beyond=True)
        return crossing.r_c_arcsec

    def turning_height(self, h_c, zeta_c):
        """h_90 [m] below the camera (Eq. 16)."""
        with mp.workdps(self.digits):
            h = mp.mpf(h_c)
            k = self.n_r(h) * mp.sin(zeta_c)
            for _ in range(60):  # n r grows by 0.75 to 1 per metre: each step gains a digit
                h -= (self.n_r(h) - k) / mp.mpf("0.9")
            return h


class RaysOfTable(ExactRays):
    """Rays through the polynomials that the kernel reads, of a table of an air."""

    def __init__(self, digits, table):
        super().__init__(digits)
        self.table = table

    def kinks(self):
        return self.table.edge_m.tolist()

    def n_r(self, h):
        edge = self.table.edge_m
        piece = np.searchsorted(edge, float(h), "right") - 1
        low, high = map(mp.mpf, edge[piece : piece + 2])
        coefficients = self.table.coefficient[piece]
        u = (h - low) / (high - low)
        terms = [u**power * c for power, c in enumerate(coefficients)]
        return (1 + mp.fsum(terms)) * (RADIUS + h)
