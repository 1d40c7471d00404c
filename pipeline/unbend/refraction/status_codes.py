"""Statuses of observations: codes inside the package, names in files."""

OK = 0
NO_STATION = 1  # the image has no exposure with position, attitude and cabin air
NO_GROUND = 2  # the height of the target is unknown
BAD_MEASUREMENT = 3  # a pixel, height, angle or distance is not a valid number
OUTSIDE_CAMERA = 4  # the camera or its window has no ray for the pixel
MISSES_GROUND = 5  # the ray never reaches the height of the target
BEYOND_GRAZING = 6
OUTSIDE_PROFILE = 7  # the profile or the method does not cover the heights
FAR_BRANCH = 8
SEVERAL_CROSSINGS = 9

STATUS_NAMES = (
    "ok",
    "no_station",
    "no_ground",
    "bad_measurement",
    "outside_camera",
    "misses_ground",
    "beyond_grazing",
    "outside_profile",
    "far_branch",
    "several_crossings",
)
"""Names by code. Observations have corrected values with ``ok``, ``beyond_grazing`` (the ray meets
the target's height twice, and the near crossing was taken), ``far_branch`` (by the slant range the
far one was taken) and ``several_crossings`` (the ray meets the terrain again, behind a ridge or a
cliff, and the first crossing was taken)."""
