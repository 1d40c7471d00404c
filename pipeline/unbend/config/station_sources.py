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
    """Stations from elsewhere, and which stations may be used."""

    orientation: OrientationSection | None = Field(
        None,
        description="position and attitude of every image, from another program",
    )
    trajectory: TrajectorySection | None = Field(
        None,
        description=(
            "a trajectory of another program, in place of the log's positions, heights or attitudes"
        ),
    )
    use_suspect: bool = Field(
        default=False,
        description=(
            "true corrects the observations of stations that contradict other evidence of the log "
            "(status suspect) too; the run ends with code 3 all the same"
        ),
        examples=[False],
    )
    max_sigma_horizontal_m: float | None = Field(
        None,
        gt=0,
        description="largest sigma of a position, per axis, that serves the mission",
        examples=[0.5],
        json_schema_extra={"unit": "m"},
    )
    max_sigma_height_m: float | None = Field(
        None,
        gt=0,
        description="largest sigma of a height that serves the mission",
        examples=[0.5],
        json_schema_extra={"unit": "m"},
    )
    max_sigma_tilt_deg: float | None = Field(
        None,
        gt=0,
        le=45,
        description="largest sigma of the attitude about a level axis that serves the mission",
        examples=[0.1],
        json_schema_extra={"unit": "deg"},
    )
