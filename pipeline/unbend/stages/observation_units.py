"""Whether the coordinates of the observations can be what the mission file says: pixels, or mm."""

import numpy as np

from unbend.config import Mission
from unbend.stages import messages
from unbend.tables.observations import Observations
from unbend.units import Array

LOOKED_AT = 20_000  # rows of the table
FEWEST_ROWS = 10  # fewer may all be blunders
NEGATIVE_SHARE = 0.25  # of x and of y, which pixels from the upper left corner never are
SMALL_PART = 0.25  # of the image's pixels: numbers of millimetres reach no farther than this
OUTSIDE_SHARE = 0.5  # of the observations: more are outside the image only in a wrong unit
FORMAT_PART = 0.6  # of the format [mm]: coordinates from its centre reach 0.5 of it
MICROMETRES_PER_MM = 1e3


def refuse_other_unit(mission: Mission, observations: Observations) -> None:
    """Refuse (OBS-UNIT) coordinates that cannot be in the unit that the mission file states.

    * Another unit than pixels: refused if, converted to pixels, more than half are outside the
      image.
    * Pixels, which count from a corner of the image: refused if x and y are both negative in a
      quarter of the rows or more, and reach as far as another unit would (`likely_unit`).
    """
    batch = next(observations.batches(LOOKED_AT))
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
    """The unit of coordinates (2, n) that count from the middle of the image; empty if pixels.

    By how far they reach: "mm" within the format of the image; "um" beyond its ``size_px``, but
    within its format. If no format is known, "mm" within a quarter of ``size_px``.
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
    return "um" if size_px < largest < MICROMETRES_PER_MM * reach_mm else ""
