"""The head of POSPac's exterior orientation: units, grid, order of rotations and shift of its rows.

The sequence of the rotations leads from the mapping frame to the image: the first rotation is the
primary one. The angles are those of the image as written, a cardinal rotation of kappa included.
"""

import re
from dataclasses import dataclass

import numpy as np

from unbend.units import RADIANS, Array

_NUMBER = r"[-+]?\d+(?:\.\d*)?"
_UNIT = re.compile(r"orientation in (deg|grad|gon|rad)", re.IGNORECASE)
_ZONE = re.compile(r"UTM\s+(North|South)\s+(\d{1,2})\b", re.IGNORECASE)
_ROTATION = re.compile(
    r"(first|second|third) rotation is about the\W+(\w+)\W+axis by the\W+(\w+)\W+angle",
    re.IGNORECASE,
)
_CARDINAL = re.compile(rf"kappa cardinal rotation\s*[:=]\s*({_NUMBER})", re.IGNORECASE)
_UNIT_OF_SHIFT = r"\W{0,9}m?\W{1,9}"  # bounded: a long run of blanks would take very long
_SHIFT = re.compile(
    rf"shift values?\s*[:=]?\s*X\s*=\s*({_NUMBER}){_UNIT_OF_SHIFT}"
    rf"Y\s*=\s*({_NUMBER}){_UNIT_OF_SHIFT}Z\s*=\s*({_NUMBER})",
    re.IGNORECASE,
)
_BLANKS = re.compile(r"\s{2,}")  # long runs would make the patterns slow

AXIS_OF_ANGLE = {"omega": "x", "phi": "y", "kappa": "z"}
ORDERS = ("omega_phi_kappa", "phi_omega_kappa")
UTM_NORTH = 32600  # plus the zone: EPSG's code of UTM on WGS 84
UTM_SOUTH = 32700  # the same of the southern hemisphere


@dataclass(frozen=True)
class EoHead:
    """Statements of the head; None, 0 or empty text where it has none.

    unit_rad : size of the unit of the angles [rad].
    grid : EPSG code of the projected coordinate system of easting, northing and the angles.
    rotations : the order of the rotations as the head states it: angle and axis of each, in words.
    order : that order as one of `ORDERS`, None if it is another; omega, phi, kappa if not stated.
    cardinal_deg : the rotation that was added to kappa [deg].
    shift_m : (3,) the shift that was added to easting, northing and height [m].
    """

    unit_rad: float | None
    grid: str | None
    rotations: str
    order: str | None
    cardinal_deg: float
    shift_m: Array


def head_of_eo(text: str) -> EoHead:
    """Read the head of an exterior orientation: the text above the titles of its columns.

    >>> head = head_of_eo("First rotation is about the 'y' axis by the 'phi' angle.\\n"
    ...     "Second rotation is about the 'x' axis by the 'omega' angle.\\n"
    ...     "Third rotation is about the 'z' axis by the 'kappa' angle.\\n"
    ...     "Kappa cardinal rotation: 90 deg\\nShift values: X = 1.5 m, Y = 0.0 m, Z = -2 m")
    >>> head.order, head.cardinal_deg, head.shift_m.tolist()
    ('phi_omega_kappa', 90.0, [1.5, 0.0, -2.0])
    """
    text = _BLANKS.sub(" ", text)
    unit = _UNIT.search(text)
    zone = _ZONE.search(text)
    rotations = [(axis.lower(), angle.lower()) for _, axis, angle in _ROTATION.findall(text)]
    order: str | None = ORDERS[0]
    if rotations:
        has_usual_axes = all(AXIS_OF_ANGLE.get(angle) == axis for axis, angle in rotations)
        order = "_".join(angle for _, angle in rotations)
        order = order if has_usual_axes and order in ORDERS else None
    cardinal = _CARDINAL.search(text)
    shift = _SHIFT.search(text)
    return EoHead(
        unit_rad=None if unit is None else _size_of_unit_rad(unit[1]),
        grid=None if zone is None else _epsg_of_utm(zone[1], int(zone[2])),
        rotations=", ".join(f"{angle} about {axis}" for axis, angle in rotations),
        order=order,
        cardinal_deg=0.0 if cardinal is None else float(cardinal[1]),
        shift_m=np.zeros(3) if shift is None else np.array(shift.groups(), np.float64),
    )


def _size_of_unit_rad(unit: str) -> float:
    """The size [rad] of deg, rad, grad or gon, by its first letter."""
    return {"d": RADIANS["deg"], "r": RADIANS["rad"], "g": RADIANS["grad"]}[unit[0].lower()]


def _epsg_of_utm(hemisphere: str, zone: int) -> str:
    """The EPSG code of a zone of UTM on WGS 84; ``hemisphere`` is North or South in any case."""
    first = UTM_SOUTH if hemisphere.lower() == "south" else UTM_NORTH
    return f"EPSG:{first + zone}"
