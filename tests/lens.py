"""How a lens draws, by OpenCV's and by Metashape's formulas, written out."""

import numpy as np

OF_METASHAPE = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")


def brown(x, y, k1, k2, p1, p2, k3):
    """Tangents right and down as the lens draws them; OpenCV's order of the coefficients."""
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return u, v


def metashape_pixels(numbers, projection, u, v):
    """(2, n) pixels from the corner, of tangents right and down.

    The user manual's appendix on camera models; ``numbers`` that a calibration lacks are zero.
    """
    f, cx, cy, b1, b2, k1, k2, k3, k4, p1, p2 = (numbers.get(name, 0.0) for name in OF_METASHAPE)
    if projection == "fisheye":
        r0 = np.hypot(u, v) + 1e-300
        scale = np.arctan(r0) / r0
        u = u * scale
        v = v * scale
    r2 = u * u + v * v
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
    x = u * radial + p1 * (r2 + 2 * u * u) + 2 * p2 * u * v
    y = v * radial + p2 * (r2 + 2 * v * v) + 2 * p1 * u * v
    x_px = numbers["width"] / 2 + cx + x * (f + b1) + y * b2
    y_px = numbers["height"] / 2 + cy + y * f
    return np.array([x_px, y_px])
