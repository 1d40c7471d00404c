"""Calibrations as other signs, other axes or the other camera would give them."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations, product

from pipeline.refraction.camera.camera import Camera

_LEAST_PX = 1.0  # that a principal point moves


def mistaken_calibrations(cameras: Mapping[str, Camera]) -> Iterator[tuple[str, dict[str, Camera]]]:
    """What a mission file may hold in place of calibrations: what that is, and the right ones.

    Only the cameras that change are there: each of them alone, all of them, or two exchanged.
    """
    groups = dict.fromkeys([*((name,) for name in cameras), tuple(cameras)])
    for group, axes in product(groups, list(product((False, True), (1, -1), (1, -1)))[1:]):
        other = {n: with_other_axes(cameras[n], *axes) for n in group}
        moved = ((c.cx_px - cameras[n].cx_px, c.cy_px - cameras[n].cy_px) for n, c in other.items())
        if min(max(abs(x), abs(y)) for x, y in moved) > _LEAST_PX:
            places = (f"{c.cx_px:.1f}, {c.cy_px:.1f} px in {n}" for n, c in other.items())
            what = f"the principal point is at {' and '.join(places)}"
            yield f"{what}: what is stated counts along other axes", other
    for group in groups:
        of = {n: cameras[n].distortion for n in group}
        other = {n: replace(cameras[n], distortion=lens._replace(**{
            key: -value for key, value in lens._asdict().items() if value and key[0] in "kpq"
        })) for n, lens in of.items()}  # fmt: skip
        if all(other[n] != cameras[n] for n in group):
            what = f"the coefficients of distortion of {' and '.join(group)}"
            yield f"{what} have the other sign: those of corrections, or the reverse", other
    for a, b in combinations(cameras, 2):
        of_a, of_b = cameras[a], cameras[b]
        a_of_b = replace(of_b, width_px=of_a.width_px, height_px=of_a.height_px)
        b_of_a = replace(of_a, width_px=of_b.width_px, height_px=of_b.height_px)
        if a_of_b != of_a and type(of_a.distortion) is type(of_b.distortion):
            yield f"the calibrations of {a} and {b} are each other's", {a: a_of_b, b: b_of_a}


def with_other_axes(camera: Camera, exchanged: bool, along_x: int, along_y: int) -> Camera:
    """The principal point with its offset from the centre along other axes."""
    half = 0.5 * camera.width_px, 0.5 * camera.height_px
    x, y = camera.cx_px - half[0], camera.cy_px - half[1]
    x, y = (y, x) if exchanged else (x, y)
    return replace(camera, cx_px=half[0] + along_x * x, cy_px=half[1] + along_y * y)


def between(camera: Camera, other: Camera, x: float) -> Camera:
    """A calibration that is 0 of the way to another, or 1, or anywhere on or beyond it."""
    names = ("fx_px", "fy_px", "cx_px", "cy_px")
    mixed = {n: (1.0 - x) * getattr(camera, n) + x * getattr(other, n) for n in names}
    lens = (p + x * (q - p) for p, q in zip(camera.distortion, other.distortion, strict=True))
    return replace(camera, **mixed, distortion=type(camera.distortion)(*lens))
