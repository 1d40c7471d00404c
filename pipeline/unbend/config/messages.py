"""What is refused about mission files, campaign files and the files of cameras.

The texts for single values are next to the check of each value, in the sections.
"""

from pathlib import Path

from unbend.errors import Code, ConfigError, InputError

CONFIG_MISSING = Code(
    "CONFIG-MISSING",
    means="There is no mission file of this name.",
    effect="The command is refused.",
    remedy="Check the path.",
)

CONFIG_UNREADABLE = Code(
    "CONFIG-UNREADABLE",
    means=(
        "The mission file cannot be read, is not UTF-8 text, or is a log, a table, a folder or "
        "another file."
    ),
    effect="The mission is refused.",
    remedy=(
        "Name a mission file; `unbend init LOG OBSERVATIONS` writes one. Check its permissions, "
        "and save it as UTF-8."
    ),
)

CONFIG_YAML = Code(
    "CONFIG-YAML",
    means="The mission file is not valid YAML, or a key occurs twice.",
    effect="The mission is refused.",
    remedy="Correct the named line: indentation, brackets, quotes.",
)

CONFIG_EMPTY = Code(
    "CONFIG-EMPTY",
    means="The mission file has no sections.",
    effect="The mission is refused.",
    remedy="Write it with `unbend init LOG OBSERVATIONS`.",
)

CONFIG_CAMPAIGN = Code(
    "CONFIG-CAMPAIGN",
    means="A campaign file was given, but the command needs one mission.",
    effect="The command is refused.",
    remedy="Name one of its mission files; run, check and status take campaigns.",
)

CONFIG_INVALID = Code(
    "CONFIG-INVALID",
    means=(
        "The mission file has values that its keys do not allow. The mistakes are listed with "
        "their lines, at most 100 of them."
    ),
    effect="The mission is refused.",
    remedy="Correct the lines; `unbend help KEY` shows the allowed values of a key.",
)

CONFIG_UNKNOWN_KEY = Code(
    "CONFIG-UNKNOWN-KEY",
    means=(
        "The mission file has unknown keys. A similar key is named, or the section of the key, or "
        "the keys that are allowed."
    ),
    effect="The mission is refused.",
    remedy="Correct the key, or move it to its section; `unbend help KEY` finds keys.",
)

CONFIG_TODO = Code(
    "CONFIG-TODO",
    means=(
        "The mission file still has open questions: values that are TODO. Each is listed with its "
        "line and its allowed values."
    ),
    effect="The mission is refused.",
    remedy="Write the values; `unbend help KEY` explains a key.",
)

CAMPAIGN_NO_MATCH = Code(
    "CAMPAIGN-NO-MATCH",
    means="No file matches a pattern under the missions of a campaign.",
    effect="The command is refused; nothing was run.",
    remedy="Correct the pattern; it is relative to the campaign file.",
)

CAMPAIGN_SAME_NAME = Code(
    "CAMPAIGN-SAME-NAME",
    means="Two missions of a campaign have one name.",
    effect="The command is refused; nothing was run.",
    remedy="Give each mission a different mission.name, in its file and not in defaults.",
)

CAMPAIGN_SAME_OUTPUT = Code(
    "CAMPAIGN-SAME-OUTPUT",
    means="Two missions of a campaign write to one folder.",
    effect="The command is refused; nothing was run.",
    remedy="Give each mission a different output.path, or leave it out.",
)

URL_INVALID = Code(
    "URL-INVALID",
    means=(
        "A path looks like a URL, but does not name an object in a bucket or container. Or it is "
        "given for a key that allows only files of this machine. URLs with a user, a password, a "
        "query or a fragment are refused, because they may contain a secret."
    ),
    effect="The mission is refused.",
    remedy="Write s3://bucket/key or az://container/key, and put credentials into the environment.",
)

CAMERA_SIZE = Code(
    "CAMERA-SIZE",
    means="The images of the calibration file have another size than the mission file states.",
    effect="The mission is refused.",
    remedy="Check width_px and height_px, or choose the camera of these images.",
)

CAMERA_FILE = Code(
    "CAMERA-FILE",
    means="The calibration in a file is impossible for a camera.",
    effect="The mission is refused.",
    remedy="Check the file, or give another one.",
)


def config_missing(*, path: Path) -> ConfigError:
    """The mission file is not there."""
    return ConfigError(CONFIG_MISSING, "there is no such file", where=path, remedy="check the path")


def config_unreadable(*, path: Path, problem: str) -> ConfigError:
    """The operating system refuses to read the file, or its text is not UTF-8."""
    return ConfigError(
        CONFIG_UNREADABLE,
        "cannot be read: {problem}",
        where=path,
        remedy="a mission file is YAML in UTF-8",
        problem=problem,
    )


def config_too_large(*, path: Path, size: int, most: int) -> ConfigError:
    """The file is larger than any mission file, and would take minutes to read."""
    return ConfigError(
        CONFIG_UNREADABLE,
        "it has {size:,} bytes; a mission file has at most {most:,}",
        where=path,
        remedy="check the path; split a large campaign into several files",
        size=size,
        most=most,
    )


def config_other_file(*, path: Path, what: str, remedy: str) -> ConfigError:
    """A file of another kind is given instead of a mission file; ``what`` it is."""
    return ConfigError(
        CONFIG_UNREADABLE,
        "is {what}, not a mission file",
        where=path,
        remedy="{advice}",
        what=what,
        advice=remedy,
    )


def config_yaml(*, where: str, problem: str) -> ConfigError:
    """The text of the file is not YAML, or a key occurs twice."""
    return ConfigError(
        CONFIG_YAML, "{problem}", where=where, remedy="correct the YAML", problem=problem
    )


def config_empty(*, path: Path, required: str) -> ConfigError:
    """The file has no keys."""
    return ConfigError(
        CONFIG_EMPTY,
        "has no sections",
        where=path,
        remedy="it needs {required}",
        required=required,
    )


def config_campaign(*, where: str) -> ConfigError:
    """A campaign file is given, but a mission file is needed."""
    return ConfigError(
        CONFIG_CAMPAIGN,
        "is a campaign file with several missions; the command needs one mission",
        where=where,
        remedy="name one of its mission files; run, check and status take campaigns",
    )


def mission_file_refused(
    code: Code, *, where: str, mistakes: list[str], has_more: bool
) -> ConfigError:
    """The file has mistakes, or open questions; one sentence for each of the first.

    ``has_more`` : whether others are not listed.
    """
    kind = "questions are open" if code is CONFIG_TODO else "mistakes"
    number = "more than {count}" if has_more else "{count}"
    several = f"{number} {kind}\n    {{mistakes}}"
    return ConfigError(
        code,
        several,
        one="{mistakes}",
        where=where,
        count=len(mistakes),
        remedy=("correct the file; `unbend help KEY` explains a key, `unbend schema` has them all"),
        mistakes="\n    ".join(mistakes),
    )


def campaign_output_is_url(*, path: Path) -> ConfigError:
    """The page of a campaign is to go to object storage."""
    return ConfigError(
        URL_INVALID,
        (
            "the page of a campaign is written to a folder of this machine, but campaign.output is "
            "a URL"
        ),
        where=path,
        remedy=(
            "name a folder; output.path under defaults may be a URL that contains the name of the "
            "mission: s3://bucket/season/{{mission}}"
        ),
    )


def campaign_no_match(*, path: Path, pattern: str) -> ConfigError:
    """A pattern of mission files matches none."""
    return ConfigError(
        CAMPAIGN_NO_MATCH,
        "missions: no file matches {pattern!r}",
        where=path,
        remedy="patterns are relative to the campaign file; ** matches any folders",
        pattern=pattern,
    )


def campaign_same_name(*, path: Path, name: str, first: Path, second: Path) -> ConfigError:
    """Two missions of a campaign have one name."""
    return ConfigError(
        CAMPAIGN_SAME_NAME,
        "two missions are called {name}: {first} and {second}",
        where=path,
        remedy=(
            "give each mission a different mission.name, in its file and not in defaults; nothing "
            "was run"
        ),
        name=name,
        first=str(first),
        second=str(second),
    )


def campaign_same_output(*, path: Path, first: str, second: str, output: str) -> ConfigError:
    """Two missions of a campaign write to one folder."""
    return ConfigError(
        CAMPAIGN_SAME_OUTPUT,
        "missions {first} and {second} both write to {output}",
        where=path,
        remedy=(
            "give each mission a different output.path, or leave it out: the default is a folder "
            "with the mission's name in the folder of the campaign; {{mission}} in the output.path "
            "of defaults is replaced by the name; nothing was run"
        ),
        first=first,
        second=second,
        output=output,
    )


def camera_size(
    *, path: Path, width: int, height: int, stated_width: int, stated_height: int
) -> InputError:
    """A calibration file is of images of another size."""
    return InputError(
        CAMERA_SIZE,
        (
            "it is of {width} x {height} px, but the mission file states {stated_width} x "
            "{stated_height}"
        ),
        where=path,
        remedy="check width_px and height_px, or choose the camera of these images",
        width=width,
        height=height,
        stated_width=stated_width,
        stated_height=stated_height,
    )


def camera_file(*, path: Path, problem: str) -> InputError:
    """The camera of a calibration file is impossible."""
    return InputError(
        CAMERA_FILE,
        "{problem}",
        where=path,
        remedy="check the file, or give another one",
        problem=problem,
    )
