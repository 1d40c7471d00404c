"""The frame of image coordinates in millimetres or micrometres: that of the metric cameras."""

from collections.abc import Mapping

from unbend.config.cameras import CameraSection
from unbend.config.observation_table import ObservationsSection
from unbend.config.section import SectionError
from unbend.tables.pixels import ImageFrame


def image_frame_of(
    observations: ObservationsSection, cameras: Mapping[str, CameraSection]
) -> ImageFrame | None:
    """The frame of image coordinates in mm or um, the same for all cameras; None for pixels.

    Refuses (SectionError) cameras without a metric report, and cameras with different frames: the
    table does not state the camera of a row.
    """
    unit_mm = observations.unit_mm
    if unit_mm is None:
        return None
    frames = set()
    for name, camera in cameras.items():
        frame = camera.image_frame(observations.pixel_origin, unit_mm)
        if frame is None:
            raise SectionError(
                f"observations.unit: {observations.unit} needs cameras.{name}.metric, which states "
                "the origin and the axes of the millimetres, and the size of a pixel",
                at=("observations", "unit"),
            )
        frames.add(frame)
    if len(frames) > 1:
        raise SectionError(
            f"observations.unit: {observations.unit} needs one frame for all cameras (the same "
            "size, pixel_um, origin and axes under metric); give the observations of the other "
            "cameras in pixels, or in separate missions",
            at=("observations", "unit"),
        )
    (frame_of_all,) = frames
    return frame_of_all
