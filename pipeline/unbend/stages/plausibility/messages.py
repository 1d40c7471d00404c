"""Messages about what looks like a mistake in a mission file."""

import math
from collections.abc import Sequence

from unbend.errors import Code, MissionError
from unbend.messages import Message, finding, note, warning
from unbend.refraction.camera.camera import Camera

PLAUSIBLE_GROUND = Code(
    "PLAUSIBLE-GROUND",
    means=(
        "The ground is more than 300 m above or below the take-off, plus 20 m for each kilometre "
        "from it."
    ),
    effect="The correction is kept. The run ends with exit code 3.",
    remedy=(
        "Check ground.height and ground.reference: heights in feet, or another zero. Or accept the "
        "finding with the reason."
    ),
)

PLAUSIBLE_TERRAIN = Code(
    "PLAUSIBLE-TERRAIN",
    means=(
        "The ground heights contradict the terrain that the autopilot logged, or the elevation "
        "model contradicts the height of the take-off."
    ),
    effect="The correction is kept. The run ends with exit code 3.",
    remedy="Check ground.height and ground.reference.",
)

PLAUSIBLE_VIEW = Code(
    "PLAUSIBLE-VIEW",
    means="The field of view or the pixels of a camera are implausible.",
    effect="The correction is kept. The run ends with exit code 3.",
    remedy="Give f in pixels, of the images that were measured.",
)


def field_of_view(
    *,
    where: str,
    name: str,
    view: float,
    width_px: int,
    height_px: int,
    fx_px: float,
    least: float,
    most: float,
) -> Message:
    """A field of view (``view`` [deg], over the diagonal) that no such camera has.

    ``least`` and ``most`` [deg] are expected.
    """
    return finding(
        PLAUSIBLE_VIEW,
        (
            "the field of view of camera {name} is {view:.3g} deg over the diagonal of {width_px} "
            "x {height_px} px with f of {fx_px:g} px, expected {least:g} to {most:g} deg: likely f "
            "in millimetres, or for another pixel size (f_px, fx_px, params, metric.pixel_um)"
        ),
        where=where,
        name=name,
        view=view,
        width_px=width_px,
        height_px=height_px,
        fx_px=fx_px,
        least=least,
        most=most,
    )


def pixels_not_square(*, where: str, name: str, fx_px: float, fy_px: float) -> Message:
    """Pixels that are not square."""
    return finding(
        PLAUSIBLE_VIEW,
        (
            "fx of camera {name} is {fx_px:g} px and fy {fy_px:g} px, expected within 2 %: likely "
            "the value of another camera or unit"
        ),
        where=where,
        name=name,
        fx_px=fx_px,
        fy_px=fy_px,
    )


PLAUSIBLE_PRINCIPAL_POINT = Code(
    "PLAUSIBLE-PRINCIPAL-POINT",
    means="The principal point is more than a tenth of the image from its centre.",
    effect="The correction is kept. The run ends with exit code 3.",
    remedy=(
        "Give pixels from the upper left corner, not an offset or millimetres. Check whether "
        "width_px and height_px are exchanged."
    ),
)


def principal_point_off(
    *, where: str, name: str, cx_px: float, cy_px: float, percent: float
) -> Message:
    """A principal point that is ``percent`` of the image from its centre."""
    return finding(
        PLAUSIBLE_PRINCIPAL_POINT,
        (
            "the principal point of {name} is at {cx_px:g}, {cy_px:g} px, which is {percent:.0f} % "
            "of the image from its centre, expected up to 10 %: likely an offset from the centre, "
            "millimetres, or width_px and height_px exchanged"
        ),
        where=where,
        name=name,
        cx_px=cx_px,
        cy_px=cy_px,
        percent=percent,
    )


def sides_exchanged(*, where: str, name: str, camera: Camera) -> Message:
    """A principal point in the middle of an image whose sides are exchanged."""
    return finding(
        PLAUSIBLE_PRINCIPAL_POINT,
        (
            "the principal point of {name} is at {cx_px:g}, {cy_px:g} px, the middle of an image "
            "of {height_px} x {width_px} px, and the stated image has {width_px} x {height_px} px: "
            "width_px and height_px seem exchanged"
        ),
        where=where,
        name=name,
        cx_px=camera.cx_px,
        cy_px=camera.cy_px,
        width_px=camera.width_px,
        height_px=camera.height_px,
    )


PLAUSIBLE_DISTORTION = Code(
    "PLAUSIBLE-DISTORTION",
    means=(
        "The distortion moves the corners of the image by an impossibly large or small amount. Or "
        "its coefficients are in another order."
    ),
    effect="The correction is kept. The run ends with exit code 3.",
    remedy="Check units (of tangents, not pixels) and the order k1, k2, p1, p2, k3.",
)


def distortion_size(*, where: str, name: str, share: float) -> Message:
    """A distortion that moves the corners by too small or too large a ``share`` of their radius."""
    return finding(
        PLAUSIBLE_DISTORTION,
        (
            "the distortion of {name} moves the corners of the image by {share:.2g} of their "
            "radius, expected 1e-6 to 0.3: likely coefficients for pixels or millimetres, not for "
            "tangents"
        ),
        where=where,
        name=name,
        share=share,
    )


def distortion_order(*, where: str, name: str, most: float) -> Message:
    """Coefficients of a distortion in another order; ``most`` is the larger of |p1| and |p2|."""
    return finding(
        PLAUSIBLE_DISTORTION,
        (
            "p1 or p2 of {name} is {most:g}, expected below 0.001: likely coefficients in another "
            "order (k1, k2, p1, p2, k3; params)"
        ),
        where=where,
        name=name,
        most=most,
    )


PLAUSIBLE_EXTENT = Code(
    "PLAUSIBLE-EXTENT",
    means=(
        "More than 1 % of the observations are outside the image, or many observations fill less "
        "than 70 % of it. They may belong to images of another size, or count from the centre of "
        "the image."
    ),
    effect="The correction is kept. The run ends with exit code 3.",
    remedy=(
        "Check width_px and height_px, the columns of x and y, and whether points were measured in "
        "reduced images."
    ),
)


def extent_of_observations(
    *,
    where: str,
    name: str,
    x: str,
    y: str,
    width_px: int,
    height_px: int,
    outside: float,
    expected: str,
    mistake: str,
) -> Message:
    """Observations that do not fill the image, or are outside it.

    ``x`` and ``y`` are ranges in words, ``outside`` is in per cent.
    """
    return finding(
        PLAUSIBLE_EXTENT,
        (
            "observations of {name} span x {x} and y {y} in an image of {width_px} x {height_px} "
            "px, {outside:.0f} % outside it, expected {expected}: likely {mistake} (width_px, "
            "height_px; observations.columns.x_px, y_px)"
        ),
        where=where,
        name=name,
        x=x,
        y=y,
        width_px=width_px,
        height_px=height_px,
        outside=outside,
        expected=expected,
        mistake=mistake,
    )


PLAUSIBLE_DIRECTION = Code(
    "PLAUSIBLE-DIRECTION",
    means=(
        "The viewing direction of a camera contradicts its name, or is near or above the horizon."
    ),
    effect="The correction is kept. The run ends with exit code 3.",
    remedy="Check the mount: degrees, signs, exchanged cameras.",
)


def camera_direction(*, where: str, name: str, axis: float, expected: str) -> Message:
    """A camera that looks ``axis`` deg from the nadir, not as ``expected``."""
    return finding(
        PLAUSIBLE_DIRECTION,
        (
            "the axis of {name} is {axis:.1f} deg from the nadir in the median, expected "
            "{expected} ({where})"
        ),
        where=where,
        name=name,
        axis=axis,
        expected=expected,
    )


PLAUSIBLE_ANGLE = Code(
    "PLAUSIBLE-ANGLE",
    means="A mount angle is a multiple of 15 degrees when it is read in radians.",
    effect="The correction is kept. The run ends with exit code 3.",
    remedy="State mount angles in degrees.",
)


def angle_in_radians(*, where: str, angle: str, name: str, value: float, deg: float) -> Message:
    """An angle of a mount that looks like radians.

    ``angle`` is its key, ``value`` the stated number, ``deg`` what that is if it is in radians.
    """
    return finding(
        PLAUSIBLE_ANGLE,
        (
            "{angle} of {name} is {value:g}, which is {deg:.0f} deg in radians: likely radians, "
            "expected degrees"
        ),
        where=where,
        angle=angle,
        name=name,
        value=value,
        deg=deg,
    )


PLAUSIBLE_LEVER_ARM = Code(
    "PLAUSIBLE-LEVER-ARM",
    means=(
        "A lever arm is longer than 10 m, or puts a camera that looks down more than 0.25 m above "
        "the antenna."
    ),
    effect="The correction is kept. The run ends with exit code 3.",
    remedy="Give metres, forward, right, down (down is positive).",
)


def lever_arm_long(*, where: str, name: str, length: float) -> Message:
    """A lever arm that is too long (``length`` [m])."""
    return finding(
        PLAUSIBLE_LEVER_ARM,
        (
            "the lever arm of {name} is {length:.0f} m long, expected less than 10 m: likely "
            "centimetres or millimetres"
        ),
        where=where,
        name=name,
        length=length,
    )


def lever_arm_above(*, where: str, name: str, up: float, most: float) -> Message:
    """A camera that looks down from ``up`` m above the antenna; allowed are ``most`` m."""
    return finding(
        PLAUSIBLE_LEVER_ARM,
        (
            "{name} looks down, but its lever arm puts it {up:.2g} m above the point with the "
            "known position, expected below it or up to {most:g} m above: likely a third number "
            "that is positive upward; here down is positive"
        ),
        where=where,
        name=name,
        up=up,
        most=most,
    )


PLAUSIBLE_SIGMA = Code(
    "PLAUSIBLE-SIGMA",
    means="The key ground.sigma_m is above 50 m.",
    effect="The sigmas follow it; the run ends with exit code 3.",
    remedy="Give the sigma in metres, not the height.",
)


def ground_sigma_large(*, where: str, sigma: float) -> Message:
    """A standard deviation of the ground (``sigma`` [m]) that is too large."""
    return finding(
        PLAUSIBLE_SIGMA,
        (
            "sigma_m of the ground is {sigma:g} m, expected below 50 m: likely millimetres or "
            "centimetres, or the height itself"
        ),
        where=where,
        sigma=sigma,
    )


PLAUSIBLE_DELAY = Code(
    "PLAUSIBLE-DELAY",
    means="delay_s under events.log is more than a second.",
    effect="The correction is kept. The run ends with exit code 3.",
    remedy="Give seconds, not milliseconds. Do not state the offset of a clock here.",
)


def delay_large(*, where: str, name: str, delay: float) -> Message:
    """A ``delay`` [s] of more than a second."""
    return finding(
        PLAUSIBLE_DELAY,
        (
            "delay_s of {name} is {delay:g} s, expected below 1 s: likely milliseconds, or the "
            "offset of a clock"
        ),
        where=where,
        name=name,
        delay=delay,
    )


PLAUSIBLE_WINDOW = Code(
    "PLAUSIBLE-WINDOW",
    means=(
        "The log has a barometer in a closed compartment, and a camera has neither a window nor an "
        "opening. Or log.channels.cabin_pressure is named, but no camera has a window. Or a window "
        "is tilted by more than 35 degrees from the optical axis."
    ),
    effect="The correction is kept. The run ends with exit code 3.",
    remedy=(
        "State window of each camera and log.channels.cabin_pressure. If the cameras are outside, "
        "state window: null and leave the channels of the cabin out. Of a tilted window check "
        "window.normal and window.frame."
    ),
)


def window_missing(*, where: str) -> Message:
    """The air of a cabin is logged, and no camera has a window."""
    return finding(
        PLAUSIBLE_WINDOW,
        (
            "log.channels.cabin_pressure is named, but no camera has a window: expected a window, "
            "or no channel of a cabin"
        ),
        where=where,
    )


def window_unstated(
    *,
    where: str,
    barometer: str,
    inside_hpa: float,
    outside_hpa: float,
    shift_px: float,
) -> Message:
    """A barometer is in a closed compartment, and the mission file says nothing of windows."""
    return finding(
        PLAUSIBLE_WINDOW,
        (
            "{barometer} is in a closed compartment (its pressure does not follow the height), but "
            "these cameras have no window. At their height it has {inside_hpa:.0f} hPa, and the "
            "air outside {outside_hpa:.0f} hPa: a window shifts points by about {shift_px:.2f} "
            "px halfway to the corner of the image. State window: {{cabin: log}} and "
            "log.channels.cabin_pressure: {barometer}, or window: null if the cameras are outside"
        ),
        where=where,
        barometer=barometer,
        inside_hpa=inside_hpa,
        outside_hpa=outside_hpa,
        shift_px=shift_px,
    )


WINDOW_NONE_STATED = Code(
    "WINDOW-NONE-STATED",
    means=(
        "The mission file states that there is no window (window: null), but the log has a "
        "barometer in a closed compartment."
    ),
    effect="No window is computed, as stated.",
    remedy="If the cameras are in that compartment, state window and log.channels.cabin_pressure.",
)


def window_stated_null(
    *,
    where: str,
    barometer: str,
    inside_hpa: float,
    outside_hpa: float,
    shift_px: float,
) -> Message:
    """A barometer is in a closed compartment, and the mission file states that no window is."""
    return note(
        WINDOW_NONE_STATED,
        (
            "window: null is stated, so no window is computed. {barometer} is in a closed "
            "compartment: at the height of the cameras it has {inside_hpa:.0f} hPa, and the air "
            "outside {outside_hpa:.0f} hPa. A window would shift points by about {shift_px:.2f} px "
            "halfway to the corner of the image"
        ),
        where=where,
        barometer=barometer,
        inside_hpa=inside_hpa,
        outside_hpa=outside_hpa,
        shift_px=shift_px,
    )


def window_leans(*, where: str, name: str, tilt: float) -> Message:
    """A window with a normal that is ``tilt`` deg from the optical axis."""
    return finding(
        PLAUSIBLE_WINDOW,
        (
            "the window of {name} is tilted by {tilt:.0f} deg from the optical axis, expected less "
            "than 35 deg: likely a normal in the frame of the body (normal, frame)"
        ),
        where=where,
        name=name,
        tilt=tilt,
    )


PLAUSIBLE_REFERENCE = Code(
    "PLAUSIBLE-REFERENCE",
    means=(
        "The camera was calibrated in flight, but the reference of its principal distance is the "
        "air of the ground. A calibration in flight contains the air of its flight in the lens."
    ),
    effect=(
        "The air in the lens is removed twice. The run ends with exit code 3. For a calibration on "
        "corrected images it is a warning: there it depends on what was corrected."
    ),
    remedy=(
        "Leave principal_distance out, or state the air in the lens during the flight of the "
        "calibration. Or accept the finding with the reason."
    ),
)


def reference_of_ground(
    *,
    where: str,
    name: str,
    reference_hpa: float,
    reference_c: float,
    in_lens_hpa: float,
    ppm: float,
    corner_px: float,
) -> Message:
    """A calibration in flight, with the air of the ground as its reference."""
    return finding(
        PLAUSIBLE_REFERENCE,
        (
            "{name} was calibrated in flight, and that calibration contains the air of its flight "
            "in the lens. But the reference, {reference_hpa:.0f} hPa and {reference_c:.0f} C, is "
            "air of the ground; here the lens is in {in_lens_hpa:.0f} hPa. So the air in the lens "
            "is removed twice: {ppm:.0f} ppm of the principal distance, {corner_px:.2f} px in the "
            "corner of an image. Leave principal_distance out, or state the air in the lens during "
            "the flight of the calibration"
        ),
        where=where,
        name=name,
        reference_hpa=reference_hpa,
        reference_c=reference_c,
        in_lens_hpa=in_lens_hpa,
        ppm=ppm,
        corner_px=corner_px,
    )


def reference_of_ground_in_corrected(
    *,
    where: str,
    name: str,
    reference_hpa: float,
    reference_c: float,
    in_lens_hpa: float,
    ppm: float,
    corner_px: float,
) -> Message:
    """A calibration in flight on corrected images, with the air of the ground as its reference.

    Only a warning, because the images may have been corrected for the air in the lens too.
    """
    return warning(
        PLAUSIBLE_REFERENCE,
        (
            "{name} was calibrated in flight on corrected images, and the reference, "
            "{reference_hpa:.0f} hPa and {reference_c:.0f} C, is air of the ground; here the lens "
            "is in {in_lens_hpa:.0f} hPa. This is right only if those images were corrected for "
            "the air in the lens too, with the same reference. If not, it is removed twice: "
            "{ppm:.0f} ppm of the principal distance, {corner_px:.2f} px in the corner of an image"
        ),
        where=where,
        name=name,
        reference_hpa=reference_hpa,
        reference_c=reference_c,
        in_lens_hpa=in_lens_hpa,
        ppm=ppm,
        corner_px=corner_px,
    )


PLAUSIBLE_DISTANCE = Code(
    "PLAUSIBLE-DISTANCE",
    means="Slant ranges do not fit the heights of camera and ground.",
    effect="The correction is kept. The run ends with exit code 3.",
    remedy="Check their unit (metres), and ground.height.",
)


def slant_ranges_off(*, where: str, ratio: float) -> Message:
    """Slant ranges that are ``ratio`` times those from the heights of camera and ground."""
    return finding(
        PLAUSIBLE_DISTANCE,
        (
            "the median slant range is {ratio:.3g} times the one from the heights of camera and "
            "ground, expected 1: likely feet or km, or another ground.height"
        ),
        where=where,
        ratio=ratio,
    )


PLAUSIBLE_FLAGGED = Code(
    "PLAUSIBLE-FLAGGED",
    means="More than a fifth of the rows are flagged for the same cause.",
    effect="These rows have no corrected values. The run ends with exit code 3.",
    remedy="Follow the cause that the entry names.",
)


def many_flagged(*, where: str, percent: float, name: str, most: float, cause: str) -> Message:
    """Too many observations with one status ``name``; at most ``most`` per cent are expected."""
    return finding(
        PLAUSIBLE_FLAGGED,
        "{percent:.0f} % of the observations are {name}, expected at most {most:.0f} %: {cause}",
        where=where,
        percent=percent,
        name=name,
        most=most,
        cause=cause,
    )


PLAUSIBLE_AIR = Code(
    "PLAUSIBLE-AIR",
    means=(
        "R differs from that of the standard atmosphere more than 1.5 times as much as in any of "
        "479 radiosonde ascents, and by more than its own sigma explains."
    ),
    effect="The correction is kept. The run ends with exit code 3.",
    remedy=(
        "Check the sources of the air that the entry names. They may be of another place or time, "
        "or have another unit or zero."
    ),
)


def air_implausible(
    *,
    where: str,
    nadir_deg: float,
    h_c_m: float,
    h_g_m: float,
    factor: float,
    sigma: float,
    expected: str,
    sources: str,
) -> Message:
    """A refraction that real air does not have.

    ``factor`` is R over R in the standard atmosphere; its ``sigma`` is left out if it is NaN.
    """
    factor_text = "{factor:.2f}" if math.isnan(sigma) else "{factor:.2f} ± {sigma:.2f}"
    return finding(
        PLAUSIBLE_AIR,
        "R at {nadir_deg:.0f} deg from {h_c_m:.0f} to {h_g_m:.0f} m is "
        + factor_text
        + " times that in the standard atmosphere, expected {expected}: likely "
        "another place, time or unit of {sources}",
        where=where,
        nadir_deg=nadir_deg,
        h_c_m=h_c_m,
        h_g_m=h_g_m,
        factor=factor,
        sigma=sigma,
        expected=expected,
        sources=sources,
    )


PLAUSIBLE_APPLY = Code(
    "PLAUSIBLE-APPLY",
    means=(
        "direction is apply, and there is no stations.orientation: the stations are those of a "
        "flight. Measured observations would then contain refraction twice."
    ),
    effect="The run ends with exit code 3.",
    remedy="Set refraction.direction: remove. If the mission is a plan, accept the finding.",
)


def refraction_applied_twice(*, where: str) -> Message:
    """Refraction is applied to observations that were measured."""
    return finding(
        PLAUSIBLE_APPLY,
        (
            "direction is apply, and the stations are from a log: measured observations would then "
            "contain refraction twice; expected remove"
        ),
        where=where,
    )


DEM_UNVERIFIED = Code(
    "DEM-UNVERIFIED",
    means=(
        "The elevation model cannot be verified, neither by tie points nor by logged terrain nor "
        "by the take-off."
    ),
    effect=(
        "None. If the model is of another place, zone or datum, or upside down, no check reports "
        "it."
    ),
    remedy=(
        "Compare the model with known heights. Give points that are measured in two or more "
        "images, or a log that begins before take-off."
    ),
)


def model_unverified(*, where: str) -> Message:
    """Nothing in the mission can contradict its elevation model."""
    return warning(
        DEM_UNVERIFIED,
        (
            "nothing in this mission can verify the elevation model: there are fewer than 10 "
            "points in two or more images, no terrain that the autopilot logged, and no log that "
            "begins at rest on the model; heights of another datum, another place or another UTM "
            "zone, or upside down, would look the same: compare it with known heights"
        ),
        where=where,
    )


TIES_HELD_BACK = Code(
    "TIES-HELD-BACK",
    means=(
        "Tie points contradict the mission file. A PLAUSIBLE- finding contradicts it too and may "
        "be the cause. Only the cause is listed."
    ),
    effect="No further effect: the cause makes the run end with exit code 3.",
    remedy=(
        "Correct or accept the cause, and run again. Then the contradictions that remain are "
        "listed."
    ),
)


def ties_held_back(*, codes: Sequence[str], keys: Sequence[str], causes: Sequence[str]) -> Message:
    """Findings of tie points are not listed, because findings of another kind may cause them.

    ``codes`` and ``keys`` are those of the findings that are not listed, ``causes`` are the codes
    of the others.
    """
    return note(
        TIES_HELD_BACK,
        (
            "tie points contradict {listed_keys} too ({listed_codes}): {causes} may be the cause; "
            "when that is corrected or accepted, the contradictions that remain are listed"
        ),
        where="stations",
        count=len(codes),
        listed_keys=", ".join(dict.fromkeys(keys)),
        listed_codes=", ".join(dict.fromkeys(codes)),
        causes=", ".join(dict.fromkeys(causes)),
    )


SIDES_HELD_BACK = Code(
    "SIDES-HELD-BACK",
    means=(
        "Width and height of an image seem exchanged. Findings that follow from that are not "
        "listed: points outside the image, and rows that are flagged because of it."
    ),
    effect="No further effect: the cause makes the run end with exit code 3.",
    remedy=(
        "Exchange width_px and height_px, or accept the cause, and run again. Then the findings "
        "that remain are listed."
    ),
)


def sides_held_back(*, codes: Sequence[str], cameras: Sequence[str]) -> Message:
    """Findings that follow from exchanged sides of the images of some cameras are not listed."""
    return note(
        SIDES_HELD_BACK,
        (
            "{listed_codes} may follow from exchanged sides of {listed_cameras}; when these are "
            "corrected or accepted, the findings that remain are listed"
        ),
        where="cameras",
        count=len(codes),
        listed_codes=", ".join(dict.fromkeys(codes)),
        listed_cameras=", ".join(cameras),
    )


ACCEPT_LOSS = Code(
    "ACCEPT-LOSS",
    means=(
        "The mission file accepts the code of a loss. A loss is data that is missing or flagged; a "
        "reason does not change that."
    ),
    effect="The mission is refused.",
    remedy=(
        "Correct the cause of the loss, and leave its code out of accept. Only findings can be "
        "accepted."
    ),
)


def loss_accepted(*, where: str, accepted_code: str) -> MissionError:
    """The mission file accepts the code of a loss."""
    return MissionError(
        ACCEPT_LOSS,
        "{accepted_code} is a loss: data is missing or flagged, and a reason does not change that",
        where=where,
        accepted_code=accepted_code,
        remedy="correct its cause; findings can be accepted, losses cannot",
    )


ACCEPT_UNUSED = Code(
    "ACCEPT-UNUSED",
    means="The mission file accepts a finding that this run does not have.",
    effect="None. The entry under accept has no effect.",
    remedy="Remove it from accept. If not, it could hide the finding later.",
)


def accepted_code_unused(*, where: str, accepted_code: str) -> Message:
    """The mission file accepts a code that no finding of this run has."""
    return warning(
        ACCEPT_UNUSED,
        "{accepted_code} is accepted, but this run has no such finding",
        where=where,
        accepted_code=accepted_code,
    )


SURFACE_FEET = Code(
    "SURFACE-FEET",
    means="The height of a weather station fits the ground only if it is in feet.",
    effect="The height is used as stated, in metres.",
    remedy="Give atmosphere.surface h_msl_m in metres: feet times 0.3048.",
)


def station_height_in_feet(
    *, where: str, stated_m: float, ground_m: float, converted_m: float
) -> Message:
    """A weather station at ``stated_m``, which is the height of the ground if it is in feet.

    ``converted_m`` is the stated height from feet to metres.
    """
    return warning(
        SURFACE_FEET,
        (
            "the station is stated {stated_m:.0f} m above sea level, but the ground of the flight, "
            "or its take-off, is at {ground_m:.0f} m: {stated_m:.0f} ft are {converted_m:.0f} m, "
            "so the height is likely in feet"
        ),
        where=where,
        stated_m=stated_m,
        ground_m=ground_m,
        converted_m=converted_m,
    )


_GROUND_OFF = (
    "the ground is {height_m:.0f} m above sea level in the median, {off_m:+.0f} m from "
    "{reference}: expected within {allowed_m:.0f} m; likely {likely}"
)


def ground_off(
    *, where: str, height_m: float, off_m: float, reference: str, allowed_m: float, likely: str
) -> Message:
    """The ground of the observations is too far above or below the take-off.

    ``height_m`` is that of the ground, ``off_m`` how far it is above the ``reference``.
    """
    return finding(
        PLAUSIBLE_GROUND,
        _GROUND_OFF,
        where=where,
        height_m=height_m,
        off_m=off_m,
        reference=reference,
        allowed_m=allowed_m,
        likely=likely,
    )


def terrain_off(
    *, where: str, height_m: float, off_m: float, reference: str, allowed_m: float, likely: str
) -> Message:
    """The ground contradicts logged terrain, or the elevation model contradicts the take-off.

    ``height_m`` is that of ground or model, ``off_m`` how far it is above the ``reference``.
    """
    return finding(
        PLAUSIBLE_TERRAIN,
        _GROUND_OFF,
        where=where,
        height_m=height_m,
        off_m=off_m,
        reference=reference,
        allowed_m=allowed_m,
        likely=likely,
    )
