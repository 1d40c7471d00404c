"""Possible mistakes in interior orientations, each with the corrected cameras.

The mistakes are coordinates of the principal point along other axes, coefficients of distortion
with the other sign, and calibrations of two cameras that were exchanged.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from itertools import combinations, product
from typing import NamedTuple

from unbend.refraction.camera.camera import Camera

LEAST_MOVE_PX = 1.0  # of a principal point: smaller moves make no difference
SIGNED_COEFFICIENTS = "kpq"  # first letters of the coefficients that a wrong sense negates


class OffsetAxes(NamedTuple):
    """The axes of a principal point's offset from the centre of the image."""

    exchanged: bool  # x and y
    sign_x: int  # of the offset to the right, after the exchange
    sign_y: int  # of the offset down, after the exchange


OTHER_AXES = (
    OffsetAxes(exchanged=False, sign_x=1, sign_y=-1),
    OffsetAxes(exchanged=False, sign_x=-1, sign_y=1),
    OffsetAxes(exchanged=False, sign_x=-1, sign_y=-1),
    OffsetAxes(exchanged=True, sign_x=1, sign_y=1),
    OffsetAxes(exchanged=True, sign_x=1, sign_y=-1),
    OffsetAxes(exchanged=True, sign_x=-1, sign_y=1),
    OffsetAxes(exchanged=True, sign_x=-1, sign_y=-1),
)
"""All axes except those of the package, x to the right and y down."""

Mistake = tuple[str, dict[str, Camera]]
"""What is wrong with calibrations, in words, and the corrected ones by name of the camera."""


def mistaken_calibrations(cameras: Mapping[str, Camera]) -> Iterator[Mistake]:
    """Possible mistakes in the calibrations of each camera alone, of all, and of each pair."""
    groups = each_and_all(cameras)
    for group, axes in product(groups, OTHER_AXES):
        cameras_of_group = {name: cameras[name] for name in group}
        yield from moved_principal_points(cameras_of_group, axes)
    for group in groups:
        cameras_of_group = {name: cameras[name] for name in group}
        yield from distortions_of_other_sign(cameras_of_group)
    for first, second in combinations(cameras, 2):
        yield from exchanged_calibrations(cameras, first, second)


def moved_principal_points(cameras: Mapping[str, Camera], axes: OffsetAxes) -> Iterator[Mistake]:
    """The mistake that principal points were stated along other axes.

    Nothing if one of them moves by less than `LEAST_MOVE_PX`.
    """
    corrected = {}
    for name, camera in cameras.items():
        moved = with_other_axes(camera, axes)
        move_x_px = abs(moved.cx_px - camera.cx_px)
        move_y_px = abs(moved.cy_px - camera.cy_px)
        if max(move_x_px, move_y_px) <= LEAST_MOVE_PX:
            return
        corrected[name] = moved
    places = [f"{c.cx_px:.1f}, {c.cy_px:.1f} px in {name}" for name, c in corrected.items()]
    principal_points = f"the principal point is at {' and '.join(places)}"
    yield f"{principal_points}: the stated ones are measured along other axes", corrected


def distortions_of_other_sign(
    cameras: Mapping[str, Camera],
) -> Iterator[Mistake]:
    """The mistake that all distortions have the other sign; nothing if a camera has none.

    >>> from unbend.refraction import BrownConrady
    >>> lens = BrownConrady(k1=-0.1, p2=0.01)
    >>> nadir = Camera(100, 80, 50.0, 50.0, 50.0, 40.0, lens)
    >>> [(_, corrected)] = distortions_of_other_sign({"nadir": nadir})
    >>> corrected["nadir"].distortion
    BrownConrady(k1=0.1, k2=0.0, k3=0.0, p1=0.0, p2=-0.01)
    """
    corrected = {}
    for name, camera in cameras.items():
        lens = camera.distortion
        negative = {}
        for key, value in lens._asdict().items():
            if value and key[0] in SIGNED_COEFFICIENTS:
                negative[key] = -value
        corrected[name] = replace(camera, distortion=lens._replace(**negative))
        if corrected[name] == camera:
            return
    coefficients = f"the coefficients of distortion of {' and '.join(cameras)}"
    yield (
        (
            f"{coefficients} have the opposite sign: those of the correction instead of the "
            "distortion, or the reverse"
        ),
        corrected,
    )


def exchanged_calibrations(
    cameras: Mapping[str, Camera], first: str, second: str
) -> Iterator[Mistake]:
    """The mistake that the calibrations of two cameras were exchanged; image sizes stay.

    Nothing if they are equal, or have different models of distortion.
    """
    camera_of_first = cameras[first]
    camera_of_second = cameras[second]
    corrected = {
        first: with_image_size(camera_of_second, camera_of_first),
        second: with_image_size(camera_of_first, camera_of_second),
    }
    same_model = type(camera_of_first.distortion) is type(camera_of_second.distortion)
    if same_model and corrected[first] != camera_of_first:
        yield f"the calibrations of {first} and {second} are exchanged", corrected


def with_image_size(camera: Camera, other: Camera) -> Camera:
    """A camera with the image size of another one."""
    return replace(camera, width_px=other.width_px, height_px=other.height_px)


def with_other_axes(camera: Camera, axes: OffsetAxes) -> Camera:
    """A camera with the offset of its principal point taken along other axes."""
    middle_x = 0.5 * camera.width_px
    middle_y = 0.5 * camera.height_px
    x = camera.cx_px - middle_x
    y = camera.cy_px - middle_y
    if axes.exchanged:
        x, y = y, x
    return replace(
        camera,
        cx_px=middle_x + axes.sign_x * x,
        cy_px=middle_y + axes.sign_y * y,
    )


def between(camera: Camera, other: Camera, share: float) -> Camera:
    """Linear interpolation of calibrations: ``camera`` at 0, ``other`` at 1, or beyond."""
    mixed = {}
    for name in ("fx_px", "fy_px", "cx_px", "cy_px"):
        start = getattr(camera, name)
        end = getattr(other, name)
        mixed[name] = (1.0 - share) * start + share * end
    coefficients = []
    for start, end in zip(camera.distortion, other.distortion, strict=True):
        coefficients.append(start + share * (end - start))
    lens = type(camera.distortion)(*coefficients)
    return replace(camera, **mixed, distortion=lens)


def each_and_all(names: Collection[str]) -> list[tuple[str, ...]]:
    """Groups of cameras: each alone, and all together if there are several.

    >>> each_and_all(["nadir", "oblique"])
    [('nadir',), ('oblique',), ('nadir', 'oblique')]
    """
    groups: list[tuple[str, ...]] = [(name,) for name in names]
    if len(groups) > 1:
        groups.append(tuple(names))
    return groups
