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
    """Name of a campaign, and where its page and table go."""

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
    """A campaign file: what its missions share, and which they are."""

    campaign: CampaignSection = Field(
        description="of a campaign file: its name, and where its page and table go",
    )
    defaults: dict[str, Any] = Field(
        {},
        description=(
            "of a campaign file: sections of a mission file that stand where a mission has none of "
            "its own; values that belong together, as a camera or a mount, are taken whole. Paths "
            "are relative to the campaign file; {mission} in output.path is the mission's name; "
            "null in a mission takes a default away"
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
