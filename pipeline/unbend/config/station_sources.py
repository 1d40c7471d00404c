"""The section of a mission file on stations from elsewhere than the log, and which may be used."""

from pydantic import (
    Field,
)

from unbend.config.orientations import OrientationSection
from unbend.config.section import (
    Section,
)
from unbend.config.trajectories import TrajectorySection


class StationsSection(Section):
    """Stations that do not come from the log, and which stations may be used."""

    orientation: OrientationSection | None = Field(
        None,
        description="position and attitude of every image, from another program",
    )
    trajectory: TrajectorySection | None = Field(
        None,
        description=(
            "a trajectory of another program, instead of the positions, heights or attitudes of "
            "the log"
        ),
    )
    use_suspect: bool = Field(
        default=False,
        description=(
            "true: observations of stations that contradict other evidence of the log (status "
            "suspect) are corrected too; the run still ends with code 3"
        ),
        examples=[False],
    )
    max_sigma_horizontal_m: float | None = Field(
        None,
        gt=0,
        description="largest allowed sigma of a position, per axis",
        examples=[0.5],
        json_schema_extra={"unit": "m"},
    )
    max_sigma_height_m: float | None = Field(
        None,
        gt=0,
        description="largest allowed sigma of a height",
        examples=[0.5],
        json_schema_extra={"unit": "m"},
    )
    max_sigma_tilt_deg: float | None = Field(
        None,
        gt=0,
        le=45,
        description="largest allowed sigma of the attitude about a level axis",
        examples=[0.1],
        json_schema_extra={"unit": "deg"},
    )
