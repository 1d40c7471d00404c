"""The sections of a campaign file."""

from typing import Any

from pydantic import (
    Field,
)

from unbend.config.section import (
    FolderOfResults,
    PathText,
    Section,
)


class CampaignSection(Section):
    """Name of a campaign, and the folder of its page and table."""

    name: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$",
        description="name of the campaign: letters, digits, dot, dash, underscore",
        examples=["season-2026"],
        json_schema_extra={
            "patternErrorMessage": "letters, digits, dots, dashes and underscores, at most 100"
        },
    )
    output: FolderOfResults = Field(
        description=(
            "folder of campaign.html and campaign.parquet, and by default of a folder for each "
            "mission"
        ),
        examples=["results"],
    )


class CampaignFile(Section):
    """A campaign file: its missions, and the keys that they share."""

    campaign: CampaignSection = Field(
        description="of a campaign file: its name, and the folder of its page and table",
    )
    defaults: dict[str, Any] = Field(
        {},
        description=(
            "of a campaign file: sections of a mission file, for missions that do not have them; "
            "values that belong together, as a camera or a mount, are used as a whole. Paths are "
            "relative to the campaign file; {mission} in output.path is the mission's name; null "
            "in a mission removes a default"
        ),
    )
    missions: list[PathText | dict[str, Any]] = Field(
        min_length=1,
        description=(
            "of a campaign file: its missions, each a mission file, a pattern of files as "
            "flights/*.yaml, or the sections themselves"
        ),
        examples=[["flights/*/mission.yaml"]],
    )
