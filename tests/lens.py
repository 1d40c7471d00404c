"""How a lens draws, by OpenCV's formula, written out."""


def brown(x, y, k1, k2, p1, p2, k3):
    """Tangents right and down as the lens draws them; OpenCV's order of the coefficients."""
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return u, v
