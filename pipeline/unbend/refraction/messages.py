"""Messages of refraction: what each code means, and the words of what is sent."""

from collections.abc import Sequence

from unbend.errors import Code, Counted, PhysicsError

ANGLE_DISTANCE = Code(
    "ANGLE-DISTANCE",
    means="The slant range of `unbend angle` is not a valid distance.",
    effect="The command is refused.",
    remedy="Give metres from camera to target, or leave --distance out.",
)


def angle_distance(*, distance: float) -> PhysicsError:
    """The slant range of `unbend angle` is not a valid distance."""
    return PhysicsError(
        ANGLE_DISTANCE,
        "invalid slant range: {distance:g} m",
        distance=distance,
        remedy="give the straight distance from camera to target in metres, or leave it out",
    )


ANGLE_WAVELENGTH = Code(
    "ANGLE-WAVELENGTH",
    means=(
        "A wavelength is given, but the formula of the refractive index is for one fixed "
        "wavelength."
    ),
    effect="The command is refused.",
    remedy="Leave --wavelength out, or --index.",
)


def angle_wavelength(*, index: str) -> PhysicsError:
    """A wavelength is given with a formula of the refractive index for one fixed wavelength."""
    return PhysicsError(
        ANGLE_WAVELENGTH,
        "the index {index!r} is for one fixed wavelength",
        index=index,
        remedy="leave the wavelength out, or use the index ciddor",
    )


CAMERA_DISTORTION = Code(
    "CAMERA-DISTORTION",
    means="The distortion more than doubles a distance from the principal point.",
    effect="The mission is refused.",
    remedy=(
        "Give the coefficients of distances in units of the principal distance, as COLMAP and "
        "OpenCV do. Check their order."
    ),
)


def camera_distortion(
    *, x: float, y: float, distance_px: float, distorted_px: float
) -> PhysicsError:
    """The distortion moves the pixel (x, y) too far away from the principal point.

    Its distance is ``distance_px`` without and ``distorted_px`` with the distortion.
    """
    return PhysicsError(
        CAMERA_DISTORTION,
        (
            "the distortion moves ({x:.0f}, {y:.0f}) px from {distance_px:.0f} to "
            "{distorted_px:.4g} px from the principal point: no lens has so much"
        ),
        x=x,
        y=y,
        distance_px=distance_px,
        distorted_px=distorted_px,
        remedy=(
            "check order and unit of the coefficients: distances are in units of the principal "
            "distance, neither in pixels nor in millimetres"
        ),
    )


CAMERA_FIELD = Code(
    "CAMERA-FIELD",
    means=(
        "With this principal distance, the field of view would be more than 150 degrees (360 "
        "degrees for a fisheye model)."
    ),
    effect="The mission is refused.",
    remedy=(
        "Give the principal distance in pixels: millimetres divided by the size of a "
        "pixel in millimetres."
    ),
)


def camera_field(*, fx_px: float, width_px: int, height_px: int, seen_deg: float) -> PhysicsError:
    """With this principal distance the field of view is ``seen_deg``, more than possible."""
    return PhysicsError(
        CAMERA_FIELD,
        (
            "with a principal distance of {fx_px:g} px, an image of {width_px} x {height_px} px "
            "has a field of view of {seen_deg:.0f} degrees"
        ),
        fx_px=fx_px,
        width_px=width_px,
        height_px=height_px,
        seen_deg=seen_deg,
        remedy=(
            "give the principal distance (f_px, or fx_px and fy_px) in pixels "
            "(millimetres divided by the size of a pixel in millimetres), or use a fisheye model"
        ),
    )


CAMERA_FORMAT = Code(
    "CAMERA-FORMAT",
    means="The pixels of a metric camera do not fill the format of its report.",
    effect="The mission is refused.",
    remedy="Check pixel_um and format_mm. Check whether width and height are exchanged.",
)


def camera_format(
    *,
    width_px: int,
    height_px: int,
    pixel_x_um: float,
    pixel_y_um: float,
    part_of_width: float,
    part_of_height: float,
) -> PhysicsError:
    """The pixels of an image do not fill the format of its report; parts are shares (0 to 1)."""
    return PhysicsError(
        CAMERA_FORMAT,
        "{width_px} x {height_px} pixels of {pixel_x_um:g} x {pixel_y_um:g} um fill "
        "{part_of_width:.3f} of the width and {part_of_height:.3f} of the height of the format",
        remedy="check pixel_um and format_mm, and whether width and height are exchanged",
        width_px=width_px,
        height_px=height_px,
        pixel_x_um=pixel_x_um,
        pixel_y_um=pixel_y_um,
        part_of_width=part_of_width,
        part_of_height=part_of_height,
    )


CAMERA_MODEL = Code(
    "CAMERA-MODEL",
    means=(
        "The camera model is unknown, has another number of parameters, or has impossible values."
    ),
    effect="The mission is refused.",
    remedy="Take a supported model (`unbend help model`), with its parameters in COLMAP's order.",
)


def camera_parameters(*, model: str, names: Sequence[str], given: Sequence[float]) -> PhysicsError:
    """The parameters of a camera model are too few, too many or impossible."""
    given_numbers = ", ".join(f"{value:g}" for value in given)
    return PhysicsError(
        CAMERA_MODEL,
        "{model} has {parameters}, {names}; {given} are given",
        remedy="give them in the order in which COLMAP writes them into cameras.txt",
        model=model,
        parameters=Counted(len(names), "parameter"),
        names=", ".join(names),
        given=given_numbers or "none",
    )


def camera_numbers(*, model: str, size: str, distances: str, point: str) -> PhysicsError:
    """A camera model has a size, a principal distance or a principal point that no camera has."""
    return PhysicsError(
        CAMERA_MODEL,
        (
            "{model} of {size} px with principal distances of {distances} px and a principal point "
            "at {point} px is not a possible camera"
        ),
        remedy="give images of 1 to 1000000 and principal distances of 10 to 1000000 pixels",
        model=model,
        size=size,
        distances=distances,
        point=point,
    )


def camera_model(*, model: str, models: str) -> PhysicsError:
    """The camera model is not known; ``models`` lists those that are."""
    return PhysicsError(
        CAMERA_MODEL,
        "{model!r} is not a supported camera model",
        model=model,
        models=models,
        remedy="supported models are {models}; convert the calibration to one of them",
    )


CAMERA_PRINCIPAL_POINT = Code(
    "CAMERA-PRINCIPAL-POINT",
    means=(
        "The principal point of a calibration report is more than a quarter of the format from the "
        "centre."
    ),
    effect="The mission is refused.",
    remedy="ppa_mm is measured from origin along axes, in millimetres. Check these three keys.",
)


def camera_principal_point(*, percent: float) -> PhysicsError:
    """The principal point of a calibration report is ``percent`` of the format off centre."""
    return PhysicsError(
        CAMERA_PRINCIPAL_POINT,
        (
            "the distance of the principal point from the centre of the format is {percent:.0f} % "
            "of the format"
        ),
        percent=percent,
        remedy=(
            "ppa_mm is measured from origin along axes, in millimetres; if it is measured from a "
            "corner, give the pixel of the corner as origin"
        ),
    )


CAMERA_REPORT = Code(
    "CAMERA-REPORT",
    means=(
        "The table of a calibration report differs by more than 2 micrometres from the "
        "coefficients, or without coefficients from a polynomial."
    ),
    effect="The mission is refused.",
    remedy="Check the sense of both, the powers of ten, the units, and the rows of the table.",
)


def camera_report(*, fit: str, apart_um: float, radius_mm: float) -> PhysicsError:
    """The table of a calibration report and its coefficients differ.

    ``fit`` names what differs: "the coefficients" of the report or "a polynomial" for the table.
    """
    return PhysicsError(
        CAMERA_REPORT,
        "the table and {fit} differ by {apart_um:.1f} um at a radius of {radius_mm:.1f} mm",
        fit=fit,
        apart_um=apart_um,
        radius_mm=radius_mm,
        remedy=(
            "check distortion.sense and table.sense (reports of the USGS have coefficients of the "
            "correction and a table of the distortion), powers of ten, units, and whether both are "
            "for the same principal distance"
        ),
    )


CAMERA_TURNS = Code(
    "CAMERA-TURNS",
    means="The distortion is not monotonic inside the image, or is a correction of more than 30 %.",
    effect="The mission is refused.",
    remedy="Check signs, order and units of the coefficients.",
)


def camera_turns(*, off_axis_deg: float, x: float, y: float) -> PhysicsError:
    """The distortion is not monotonic inside the image, or is a correction of more than 30 %."""
    return PhysicsError(
        CAMERA_TURNS,
        (
            "the distortion is not monotonic inside the image (or is a correction of more than 30 "
            "%), {off_axis_deg:.1f} degrees off the axis at ({x:.0f}, {y:.0f}) px"
        ),
        off_axis_deg=off_axis_deg,
        x=x,
        y=y,
        remedy="check signs, order and units of the coefficients",
    )


METHOD_NAME = Code(
    "METHOD-NAME",
    means="No refraction method has this name.",
    effect="The command is refused.",
    remedy="Take one that `unbend angle --help` lists.",
)


def method_name(*, method: str, known: str) -> PhysicsError:
    """No refraction method has this name."""
    return PhysicsError(
        METHOD_NAME,
        "no refraction method is called {method!r}",
        method=method,
        known=known,
        remedy="one of {known}",
    )


METHOD_SPAN = Code(
    "METHOD-SPAN",
    means="A parabola of the refractivity cannot be fitted over these heights.",
    effect="The call is refused.",
    remedy="Give heights inside the profile, the lower one first.",
)


def method_span(*, where: object, lowest: float, highest: float) -> PhysicsError:
    """A parabola of the refractivity cannot be fitted over these heights [m]."""
    return PhysicsError(
        METHOD_SPAN,
        "a parabola cannot be fitted from {lowest:.0f} to {highest:.0f} m",
        where=where,
        lowest=lowest,
        highest=highest,
        remedy="give heights inside the profile, the lower one first",
    )


METHOD_STEP = Code(
    "METHOD-STEP",
    means="The step of the published quadrature is not positive.",
    effect="The call is refused.",
    remedy="Give one, as 1000 m.",
)


def method_step(*, step: float) -> PhysicsError:
    """The step of the published quadrature is not positive."""
    return PhysicsError(
        METHOD_STEP,
        "a step of {step:g} m is not positive",
        step=step,
        remedy="for example 1000 m",
    )


PAPER_NAME = Code(
    "PAPER-NAME",
    means="No paper has this name.",
    effect="The command is refused.",
    remedy="Take gyer1996, saastamoinen1974 or bertram1966.",
)


def paper_name(*, paper: str, papers: str) -> PhysicsError:
    """No paper has this name."""
    return PhysicsError(
        PAPER_NAME,
        "no paper is called {paper!r}",
        paper=paper,
        papers=papers,
        remedy="one of {papers}",
    )


RADIAL_ANGLE = Code(
    "RADIAL-ANGLE",
    means="A radial table goes from the nadir to less than 90 degrees, in steps above 0.",
    effect="The command is refused.",
    remedy="Choose --max-angle above 0 and below 90, and --step above 0.",
)


def radial_angle(*, least_deg: float, largest_deg: float) -> PhysicsError:
    """A radial table contains angles below 0, or at the horizon or beyond."""
    return PhysicsError(
        RADIAL_ANGLE,
        (
            "a radial table goes from the nadir to below the horizon, not from {least_deg:g} "
            "to {largest_deg:g} degrees"
        ),
        least_deg=least_deg,
        largest_deg=largest_deg,
        remedy="choose a largest nadir angle of more than 0 and less than 90 degrees",
    )


def radial_angle_angles_to(*, largest_deg: float, step_deg: float) -> PhysicsError:
    """The largest nadir angle or the step of a radial table is not possible."""
    return PhysicsError(
        RADIAL_ANGLE,
        "nadir angles up to {largest_deg:g} degrees in steps of {step_deg:g} are not possible",
        largest_deg=largest_deg,
        step_deg=step_deg,
        remedy="choose a largest nadir angle of more than 0 and less than 90 degrees",
    )


RADIAL_FOCAL = Code(
    "RADIAL-FOCAL",
    means="The principal distance is not valid.",
    effect="The command is refused.",
    remedy="Give it in pixels.",
)


def radial_focal(*, focal_px: float) -> PhysicsError:
    """The principal distance is not a positive number."""
    return PhysicsError(
        RADIAL_FOCAL,
        "invalid principal distance: {focal_px:g} px",
        remedy="give it in pixels, above 0",
        focal_px=focal_px,
    )


RADIAL_HEIGHTS = Code(
    "RADIAL-HEIGHTS",
    means="The camera is not above the ground.",
    effect="The command is refused.",
    remedy="Give both in metres above sea level.",
)


def radial_heights(*, h_c: float, h_g: float) -> PhysicsError:
    """The camera is not above the ground."""
    return PhysicsError(
        RADIAL_HEIGHTS,
        "a camera at {h_c:g} m is not above a ground at {h_g:g} m",
        h_c=h_c,
        h_g=h_g,
        remedy="give both in metres above sea level; the camera must be the higher one",
    )


WINDOW_AIR = Code(
    "WINDOW-AIR",
    means="A plane window needs the air behind it.",
    effect="The mission is refused.",
    remedy="Give cameras.<name>.window.cabin.",
)


def window_without_air() -> PhysicsError:
    """A plane window is given without the air behind it."""
    return PhysicsError(
        WINDOW_AIR,
        "the air behind the window is missing: the bending of rays by a plane window depends on it",
        remedy="give the cabin's air",
    )


WINDOW_NORMAL = Code(
    "WINDOW-NORMAL",
    means="The normal of a window is not a unit vector, or points into the compartment.",
    effect="The mission is refused.",
    remedy=(
        "Give the direction out of the window. In the camera frame its third number is positive."
    ),
)


def window_normal(*, length: float) -> PhysicsError:
    """The normal of a window is not a unit vector."""
    return PhysicsError(
        WINDOW_NORMAL,
        "the normal of a window has the length {length:.9g}",
        length=length,
        remedy="give a unit vector that points out of the compartment",
    )


def window_normal_inwards() -> PhysicsError:
    """The normal of a window points into the compartment."""
    return PhysicsError(
        WINDOW_NORMAL,
        "the normal of a window points into the compartment",
        remedy="in the camera frame its third component is positive",
    )


RAY_BAD_MEASUREMENT = Code(
    "RAY-BAD-MEASUREMENT",
    means=(
        "Heights or the nadir angle of a ray are not numbers, the radius is not above 0, or nadir "
        "angles are outside 0 to pi, as degrees are."
    ),
    effect="The call is refused.",
    remedy="Give heights in metres and the angle in radians (0 to pi).",
)


CHECK_RAY = "check heights, angle and radius (inside the package angles are radians)"


def ray_bad_measurement(*, where: str) -> PhysicsError:
    """The heights, the angle or the radius of a ray are not valid numbers; ``where`` lists them."""
    return PhysicsError(
        RAY_BAD_MEASUREMENT,
        "heights and angle (0 to 180 degrees) must be numbers, the radius above 0",
        where=where,
        remedy=CHECK_RAY,
    )


def nadir_angles_outside(*, where: str, count: int, total: int, first: float) -> PhysicsError:
    """``count`` of ``total`` nadir angles are outside 0 to pi; the ``first`` is at ``where``."""
    return PhysicsError(
        RAY_BAD_MEASUREMENT,
        "{count} of {total} nadir angles are outside 0 to pi, the first is {first:.10g}",
        one="the nadir angle {first:.10g} is outside 0 to pi",
        where=where,
        count=count,
        total=total,
        first=first,
        remedy="give the nadir angle in radians; if these are degrees, use numpy.radians",
    )


RAY_MISSES_GROUND = Code(
    "RAY-MISSES-GROUND",
    means="The ray never reaches the height of the target.",
    effect="The call is refused.",
    remedy="Check heights and nadir angle.",
)


def ray_misses_ground(*, where: str) -> PhysicsError:
    """A ray never reaches the height of its target; ``where`` lists heights and angle."""
    return PhysicsError(
        RAY_MISSES_GROUND,
        "the ray never reaches the target's height",
        where=where,
        remedy=CHECK_RAY,
    )


RAY_OUTSIDE_PROFILE = Code(
    "RAY-OUTSIDE-PROFILE",
    means="The profile or the method does not cover the heights.",
    effect="The call is refused.",
    remedy="Give heights inside the profile.",
)


def ray_outside_profile(*, where: str, bottom_m: float, top_m: float, method: str) -> PhysicsError:
    """The profile or the method does not cover the heights of a ray."""
    return PhysicsError(
        RAY_OUTSIDE_PROFILE,
        "the profile ({bottom_m:.0f} to {top_m:.0f} m) or the method ({method}) does not cover "
        "the heights",
        where=where,
        remedy=CHECK_RAY,
        bottom_m=bottom_m,
        top_m=top_m,
        method=method,
    )
