"""Whether the coordinates of the observations can be in the stated unit: px, mm or um."""

import numpy as np

from unbend.config import Mission
from unbend.stages import messages
from unbend.tables.observations import Observations
from unbend.units import Array

CHECKED_ROWS = 20_000  # the first ones of the table
FEWEST_ROWS = 10  # fewer may all be blunders
NEGATIVE_SHARE = 0.25  # of x and of y; pixels from the upper left corner are not negative
SMALL_PART = 0.25  # of the image's size [px]: millimetres from the centre stay below this number
OUTSIDE_SHARE = 0.5  # of the observations: more are outside the image only in a wrong unit
FORMAT_PART = 0.6  # of the format [mm]: coordinates from its centre reach 0.5 of it
MICROMETRES_PER_MM = 1e3


def refuse_other_unit(mission: Mission, observations: Observations) -> None:
    """Refuse (OBS-UNIT) coordinates that cannot be in the unit that the mission file states.

    * mm or um: refused if more than half of the observations, which are converted to pixels when
      they are read, are outside the image.
    * Pixels, which count from a corner of the image: refused if a quarter of the x and a quarter of
      the y are negative, and their size fits millimetres or micrometres (`likely_unit`).
    """
    batch = next(observations.batches(CHECKED_ROWS))
    is_known = np.isfinite(batch.x_px) & np.isfinite(batch.y_px)
    if np.count_nonzero(is_known) < FEWEST_ROWS:
        return
    xy = np.stack([batch.x_px[is_known], batch.y_px[is_known]])
    cameras = mission.interior_orientations.values()
    size = np.array(
        [
            [max(camera.width_px for camera in cameras)],
            [max(camera.height_px for camera in cameras)],
        ]
    )
    unit = mission.observations.unit
    if unit != "px":
        outside = ((xy < 0.0) | (xy > size)).any(axis=0)
        if outside.mean() > OUTSIDE_SHARE:
            raise messages.coordinates_beyond_frame(
                where=str(observations.path), unit=unit, percent=100.0 * float(outside.mean())
            )
        return
    negative = (xy < 0.0).mean(axis=1)
    if negative.min() < NEGATIVE_SHARE:
        return
    likely = likely_unit(mission, xy, float(size.max()))
    if likely:
        raise messages.coordinates_without_pixels(
            where=str(observations.path),
            percent=100.0 * float(negative.min()),
            largest=float(np.abs(xy).max()),
            likely=likely,
        )


def likely_unit(mission: Mission, xy: Array, size_px: float) -> str:
    """The likely unit of coordinates ``xy`` (2, n) from the middle of an image: "mm", "um" or "".

    ``size_px`` is the longer side of the largest image. The 99 % quantile L of the absolute
    coordinates decides:

    * "mm" if L is within the format of the camera in millimetres;
    * "um" if L is more than ``size_px``, but within the format in micrometres;
    * "" otherwise: they may be pixels.

    Without a known format "mm" if L is less than a quarter of ``size_px``, else "".
    """
    largest = float(np.percentile(np.abs(xy), 99.0))
    formats_mm = [
        max(camera.metric.format_mm) for camera in mission.cameras.values() if camera.metric
    ]
    if not formats_mm:
        return "mm" if largest < SMALL_PART * size_px else ""
    reach_mm = FORMAT_PART * max(formats_mm)
    if largest < reach_mm:
        return "mm"
    if size_px < largest < MICROMETRES_PER_MM * reach_mm:
        return "um"
    return ""
