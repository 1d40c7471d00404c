"""Compare known positions of images with the stations of a block, to test the frame of the block.

Known positions come from the same files or the log (EXIF, pose priors, the reference of a project,
exposures). They show a block that is turned, tilted, of another scale or elsewhere. Single
positions are not tested: receivers in cameras have errors of metres.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from unbend.block import messages
from unbend.flight.image_names import composed
from unbend.flight.stations import Stations
from unbend.geodesy import ecef_of_geodetic, enu_from_ecef
from unbend.messages import Message, Notes
from unbend.units import Array, Mask, Names

FEWEST_FOR_A_TURN = 4  # images for turn and scale; with three, residuals show hardly anything
OUTLIER_SIGMAS = 4.0  # residuals beyond this, in robust sigmas, do not count in the fit
MAD_OF_SIGMA = 0.6745  # median absolute residual of a normal distribution, in sigmas
SIGNIFICANT_SIGMAS = 5.0  # a smaller turn, tilt or scale is noise
OVER_RESIDUAL = 3.0  # times the residual: a smaller shift at the block's edge may be a drift
SMALLEST_TURN_RAD = np.radians(0.3)  # smaller ones do not matter: 5 deg turn R by 9 %
SMALLEST_TILT_RAD = np.radians(0.3)  # changes R by 1 % at 45 deg
SMALLEST_SCALE = 0.005  # relative change of the height above ground, and so of R
SMALLEST_STEP_M = 2.0  # horizontal shift at the edge of the block: receivers drift by as much
SMALLEST_RISE_M = 5.0  # vertical shift at the edge of the block: receivers drift by as much
LARGEST_OFFSET_M = 20.0  # of the middle of all images: receiver, clock and datum together
LARGEST_HEIGHT_OFFSET_M = 150.0  # undulations and zeros of barometers are smaller
LARGEST_RESIDUAL_M = 20.0  # horizontal, of a fit with turn and scale
LARGEST_RESIDUAL = 0.02  # the same as a share of the extent
LINE_WIDTH = 0.05  # width over length: narrower images are on a line


@dataclass(
    frozen=True,
    eq=False,
)
class KnownPlaces:
    """Positions of images from one source."""

    source: str  # in words
    image: Names  # (m,)
    position: Array  # (m, 3) latitude, longitude [rad], height [m] of any reference; NaN unknown
    in_frame: bool = False  # True: ``position`` is x, y, z in the frame of the block instead

    def rows_of(self, image: Names) -> Array:
        """(n, 3) the positions of images by their names, NaN for an image without one."""
        row_of_name = {composed(name): row for row, name in enumerate(self.image.tolist())}
        position = np.full((len(image), 3), np.nan)
        for row, name in enumerate(image.tolist()):
            known_row = row_of_name.get(composed(name))
            if known_row is not None:
                position[row] = self.position[known_row]
        return position


@dataclass(frozen=True)
class PlaceComparison:
    """Known positions compared with those of the block.

    Turn, scale and tilt bring the block to the known positions; NaN if too few images show them.
    """

    count: int  # of the images
    extent_m: float  # diagonal of the box around the known positions, horizontal
    offset_m: float  # horizontal, median of known minus block
    height_m: float  # the same of heights, NaN without known heights
    residual_m: float  # horizontal distance after the shift, turn and scale (rms)
    turn_rad: float = np.nan  # about the vertical, clockwise
    scale: float = np.nan
    sigma_turn: float = np.nan  # of the turn [rad], and relative of the scale
    tilt_rad: float = np.nan
    sigma_tilt_rad: float = np.nan
    rise_residual_m: float = np.nan  # of heights after the tilt (rms)

    @property
    def contradictions(self) -> list[str]:
        """The properties of the frame that the known positions contradict, in words."""
        texts = self.turns_and_scales()
        if self.is_tilted:
            angle_deg = np.degrees(self.tilt_rad)
            texts.append(f"it is tilted by {angle_deg:.2f} deg")
        if self.offset_m > LARGEST_OFFSET_M:
            texts.append(f"it is {self.offset_m:,.0f} m away")
        if abs(self.height_m) > LARGEST_HEIGHT_OFFSET_M:
            texts.append(f"its heights differ by {self.height_m:,.0f} m")
        usual_m = max(LARGEST_RESIDUAL_M, LARGEST_RESIDUAL * self.extent_m)
        if self.residual_m > usual_m:
            texts.append(f"no turn, scale and shift leaves less than {self.residual_m:,.0f} m")
        return texts

    def turns_and_scales(self) -> list[str]:
        """The turn and the scale in words, each if it is larger than noise and drift."""
        texts = []
        half_m = 0.5 * self.extent_m
        tolerated_m = max(OVER_RESIDUAL * self.residual_m, SMALLEST_STEP_M)  # at the edge
        noise = SIGNIFICANT_SIGMAS * self.sigma_turn
        turn = abs(self.turn_rad)
        if turn > max(SMALLEST_TURN_RAD, noise) and turn * half_m > tolerated_m:
            angle_deg = np.degrees(turn)
            texts.append(f"it is turned by {angle_deg:.2f} deg about the vertical")
        stretch = abs(self.scale - 1.0)
        smallest_stretch = max(SMALLEST_SCALE, noise * self.scale)
        if stretch > smallest_stretch and stretch * half_m > tolerated_m:
            texts.append(f"its lengths must be multiplied by {self.scale:.4g}")
        return texts

    @property
    def is_tilted(self) -> bool:
        """Whether the tilt is larger than noise and drift of heights explain; False for NaN."""
        rise_m = self.tilt_rad * 0.5 * self.extent_m
        noise = SIGNIFICANT_SIGMAS * self.sigma_tilt_rad
        smallest_rise_m = max(OVER_RESIDUAL * self.rise_residual_m, SMALLEST_RISE_M)
        return self.tilt_rad > max(SMALLEST_TILT_RAD, noise) and rise_m > smallest_rise_m

    @property
    def tested(self) -> str:
        """The compared properties with their values and sigmas, in words."""
        parts = [f"{self.offset_m:.1f} m apart at the centre"]
        if np.isfinite(self.turn_rad):
            degrees = np.degrees(abs(self.turn_rad))
            sigma = np.degrees(self.sigma_turn)
            parts.append(f"turned by {degrees:.2f} ± {sigma:.2g} deg")
            parts.append(f"scale {self.scale:.5g} ± {self.sigma_turn:.2g}")
        if np.isfinite(self.tilt_rad):
            degrees = np.degrees(self.tilt_rad)
            sigma = np.degrees(self.sigma_tilt_rad)
            parts.append(f"tilted by {degrees:.2f} ± {sigma:.2g} deg")
        if np.isfinite(self.height_m):
            parts.append(f"heights differ by {self.height_m:.0f} m, whatever they count from")
        return ", ".join(parts)


def compared_places(
    stations: Stations,
    known: Array,
) -> PlaceComparison | None:
    """Compare stations with their known positions; None if no station has both.

    ``known`` (n, 3) are latitude, longitude [rad] and height [m] by station, NaN where unknown.
    Turn, scale and tilt need at least `FEWEST_FOR_A_TURN` images.
    """
    position = np.stack([stations.lat_rad, stations.lon_rad, stations.h_ellipsoid_m], axis=1)
    usable = np.isfinite(known[:, :2]).all(axis=1) & np.isfinite(position).all(axis=1)
    if not usable.any():
        return None
    block_enu, known_enu, has_height = in_one_plane(position[usable], known[usable])
    apart = known_enu - block_enu
    middle = np.median(apart, axis=0)
    square = np.sum((apart - middle)[:, :2] ** 2, axis=1)
    extent = float(np.linalg.norm(np.ptp(known_enu[:, :2], axis=0)))
    heights = apart[has_height, 2]
    comparison = PlaceComparison(
        count=int(usable.sum()),
        extent_m=extent,
        offset_m=float(np.hypot(middle[0], middle[1])),
        height_m=float(np.median(heights)) if heights.size else np.nan,
        residual_m=float(np.sqrt(square.mean())),
    )
    if comparison.count < FEWEST_FOR_A_TURN or extent == 0.0 or not np.ptp(block_enu[:, 0]):
        return comparison
    return with_turn(comparison, block_enu, known_enu, has_height)


def in_one_plane(
    position: Array,
    known: Array,
) -> tuple[Array, Array, Mask]:
    """Block and known positions in east, north, up [m] at the middle of the known ones.

    Both are given as latitude, longitude [rad] and height [m], (n, 3). Returns the positions of the
    block, the known ones (n, 3), and a mask (n,) of those with a known height; others get the
    height of the block.
    """
    has_height = np.isfinite(known[:, 2])
    height = np.where(has_height, known[:, 2], position[:, 2])
    block_ecef = ecef_of_geodetic(*position.T)
    known_ecef = ecef_of_geodetic(known[:, 0], known[:, 1], height)
    middle = np.median(known, axis=0)
    to_enu = enu_from_ecef(middle[:1], middle[1:2])[0]
    origin = np.median(known_ecef, axis=0)
    block_enu = (block_ecef - origin) @ to_enu.T
    known_enu = (known_ecef - origin) @ to_enu.T
    return block_enu, known_enu, has_height


def with_turn(
    comparison: PlaceComparison,
    block_enu: Array,
    known_enu: Array,
    has_height: Mask,
) -> PlaceComparison:
    """The comparison with turn, scale and tilt, fitted without outliers.

    ``block_enu`` and ``known_enu`` (n, 3) are positions in one local frame [m]. The horizontal fit
    takes east + i north as a complex number: w = factor z, with factor = scale exp(-i turn).
    """
    z = block_enu[:, 0] + 1j * block_enu[:, 1]
    w = known_enu[:, 0] + 1j * known_enu[:, 1]
    keep = np.ones(z.size, np.bool_)
    for _ in range(3):  # the first fits are still affected by outliers
        factor, miss = plane_similarity(z, w, keep)
        keep = within_usual(np.abs(miss))
    spread = float(np.sqrt(np.sum(np.abs(z[keep] - z[keep].mean()) ** 2)))
    residual = float(np.sqrt(np.mean(np.abs(miss[keep]) ** 2)))
    sigma = residual / np.sqrt(2.0) / (abs(factor) * spread) if spread else np.nan
    tilt = None
    tilt_rows = keep & has_height
    if int(tilt_rows.sum()) >= FEWEST_FOR_A_TURN:
        tilt = tilt_of(block_enu[tilt_rows], known_enu[tilt_rows])
    turned = replace(
        comparison,
        turn_rad=float(-np.angle(factor)),
        scale=float(abs(factor)),
        sigma_turn=float(sigma),
        residual_m=residual,
    )
    if tilt is None:
        return turned
    return replace(
        turned,
        tilt_rad=tilt.angle_rad,
        sigma_tilt_rad=tilt.sigma_rad,
        rise_residual_m=tilt.residual_m,
    )


@dataclass(frozen=True)
class Tilt:
    """The tilt of a block against known heights."""

    angle_rad: float
    sigma_rad: float
    residual_m: float  # of heights after the tilt (rms)


def plane_similarity(
    z: Array,
    w: Array,
    keep: Mask,
) -> tuple[complex, Array]:
    """Least-squares factor of w - mean(w) = factor (z - mean(z)), and the residuals (n,) of all.

    Only rows of ``keep`` (n,) count in the fit. The factor is 1 if all z are equal.
    """
    centred_z = z - z[keep].mean()
    centred_w = w - w[keep].mean()
    power = float(np.sum(np.abs(centred_z[keep]) ** 2))
    factor = complex(np.vdot(centred_z[keep], centred_w[keep]) / power) if power else 1.0 + 0.0j
    return factor, centred_w - factor * centred_z


def within_usual(distance: Array) -> Mask:
    """(n,) whether a distance is within `OUTLIER_SIGMAS` robust sigmas of 0."""
    sigma = float(np.median(distance)) / MAD_OF_SIGMA
    return np.asarray(distance <= max(OUTLIER_SIGMAS * sigma, 1e-9))  # 1e-9: exact fits stay


def tilt_of(
    block_enu: Array,
    known_enu: Array,
) -> Tilt | None:
    """The tilt of a plane fitted to known heights minus those of the block, without outliers.

    None for images on a line, because they do not show a tilt across it.
    """
    flat = known_enu[:, :2] - known_enu[:, :2].mean(axis=0)
    length, width = np.linalg.svd(flat, compute_uv=False)
    if width < LINE_WIDTH * length:
        return None
    rise = known_enu[:, 2] - block_enu[:, 2]
    keep = np.ones(rise.size, np.bool_)
    design = np.column_stack([flat, np.ones(rise.size)])
    for _ in range(3):
        slopes = np.linalg.lstsq(design[keep], rise[keep], rcond=None)[0]
        miss = rise - design @ slopes
        keep = within_usual(np.abs(miss))
    residual = float(np.sqrt(np.mean(miss[keep] ** 2)))
    return Tilt(
        angle_rad=float(np.arctan(np.hypot(slopes[0], slopes[1]))),
        sigma_rad=residual / float(width),
        residual_m=residual,
    )


def frame_notes(
    stations: Stations,
    known: Iterable[tuple[str, Array]],
    *,
    must_be_tested: bool,
    where: str,
    system: str = "",
    has_tested_heights: bool = False,
) -> Notes:
    """Compare known positions with the stations of a block, and report on the block's frame.

    For each source a finding (FRAME-PLACES) if it contradicts the frame, or else a note
    (FRAME-CONFIRMED).

    Parameters
    ----------
    known : pairs of a source in words and positions (n, 3) of the stations, as `compared_places`
        takes them.
    must_be_tested : give a warning (FRAME-UNVERIFIED) if no source has positions of four images.
    where : the place of the messages.
    system : the coordinate system of a map, for the warning; empty for another frame.
    has_tested_heights : tie points show the heights above a given ground.
    """
    notes: list[Message] = []
    is_tested = False
    for source, position in known:
        comparison = compared_places(stations, position)
        if comparison is None:
            continue
        contradictions = comparison.contradictions
        if contradictions:
            notes.append(
                messages.frame_contradicts_places(
                    where=where,
                    count=comparison.count,
                    source=source,
                    contradictions="; ".join(contradictions),
                    extent=comparison.extent_m,
                    residual=comparison.residual_m,
                )
            )
        else:
            notes.append(
                messages.frame_confirmed(
                    where=where,
                    count=comparison.count,
                    source=source,
                    tested=comparison.tested,
                    residual=comparison.residual_m,
                )
            )
        is_tested = is_tested or bool(contradictions) or np.isfinite(comparison.turn_rad)
    if must_be_tested and not is_tested:
        untested = messages.untested_in_words(
            is_map=bool(system), has_tested_heights=has_tested_heights
        )
        notes.append(unverified(stations, where, system, untested))
    return tuple(notes)


def unverified(stations: Stations, where: str, system: str, untested: str) -> Message:
    """The warning that nothing confirms a frame, with its extent, heights and place.

    ``untested`` lists the untested properties in words.
    """
    ok = stations.ok
    position = np.stack([stations.lat_rad, stations.lon_rad, stations.h_ellipsoid_m], axis=1)[ok]
    extent = np.nan
    if len(position):
        block, _, _ = in_one_plane(position, position)
        extent = float(np.linalg.norm(np.ptp(block[:, :2], axis=0)))
    lowest_m = float(np.min(stations.h_msl_m[ok], initial=np.inf))
    highest_m = float(np.max(stations.h_msl_m[ok], initial=-np.inf))
    return messages.frame_unverified(
        where=where,
        count=int(ok.sum()),
        untested=untested,
        extent=extent,
        heights=(lowest_m, highest_m),
        latitude_deg=float(np.degrees(stations.mean_latitude_rad)),
        longitude_deg=float(np.degrees(stations.median_longitude_rad)),
        system=system,
    )
