"""Refusals of command lines: codes and their words."""

from unbend.errors import STORAGE_WRITE, Code, ConfigError, StorageError

COMMAND_ORDER = Code(
    "COMMAND-ORDER",
    means="The first word of the command line is a file, not a command.",
    effect="Nothing is run.",
    remedy="Write the command first: unbend run mission.yaml.",
)
COMMAND_PATH = Code(
    "COMMAND-PATH",
    means="A path in the command line is longer than a path of this system can be.",
    effect="Nothing is run.",
    remedy="Check whether the shell pasted other text into the path.",
)
RUN_ARGUMENTS = Code(
    "RUN-ARGUMENTS",
    means="Options of `run` that cannot be combined.",
    effect="Nothing is run.",
    remedy="Leave one of them out.",
)
INSPECT_ARGUMENTS = Code(
    "INSPECT-ARGUMENTS",
    means="The options of `unbend inspect` cannot be combined.",
    effect="The command is refused.",
    remedy="For example: unbend inspect flight.bin --type BARO --csv.",
)
ANGLE_ARGUMENTS = Code(
    "ANGLE-ARGUMENTS",
    means=(
        "One angle is requested with options of the table of angles, or a table with options of "
        "one angle."
    ),
    effect="The command is refused.",
    remedy="Give --nadir-angle for one angle. Leave it out for a table.",
)
PROFILE_ARGUMENTS = Code(
    "PROFILE-ARGUMENTS",
    means="Either a mission file or --atmosphere is needed, not both.",
    effect="The command is refused.",
    remedy="For example: --atmosphere us1976.",
)
PAGE_FORMAT = Code(
    "PAGE-FORMAT",
    means="The page is Markdown, and the file does not end in .md.",
    effect="The command is refused.",
    remedy="Choose a name that ends in .md.",
)
INIT_EXISTS = Code(
    "INIT-EXISTS",
    means="`unbend init` would overwrite a file that exists already.",
    effect="Nothing was written.",
    remedy="Choose another name with --out, or replace the file with --force.",
)


def command_not_first(*, word: str, line: str) -> ConfigError:
    """The command does not come first; ``line`` has it there."""
    return ConfigError(
        COMMAND_ORDER,
        "{word!r} is not a command: the command comes first",
        remedy="write: {line}",
        word=word,
        line=line,
    )


def path_too_long(*, path: str) -> ConfigError:
    """The system cannot look for a path of the command line."""
    return ConfigError(
        COMMAND_PATH,
        "a path of {length} characters: it or a name in it is too long",
        where=path,
        remedy="give the path of an existing file or folder",
        length=len(path),
    )


def jobs_and_scheduler() -> ConfigError:
    """`run` is given processes of this machine, and a scheduler of others."""
    return ConfigError(
        RUN_ARGUMENTS,
        "--jobs and --scheduler cannot be combined",
        remedy=(
            "the number of workers of the scheduler states how many missions run at the same time"
        ),
    )


def inspect_options() -> ConfigError:
    """`inspect` is given options of one type of messages without a type, or CSV as JSON."""
    return ConfigError(
        INSPECT_ARGUMENTS,
        "--csv and --instance need --type; --csv cannot be combined with --json",
        remedy="for example: unbend inspect flight.bin --type BARO --csv",
    )


def camera_without_config() -> ConfigError:
    """`angle` is given a camera, but no mission file that describes it."""
    return ConfigError(
        ANGLE_ARGUMENTS,
        "--camera: only for a mission file (--config)",
        remedy="give --config with --camera",
    )


def angle_options(*, options: str, other: str) -> ConfigError:
    """`angle` is given options that go with ``other`` alone."""
    return ConfigError(
        ANGLE_ARGUMENTS,
        "{options}: only for {other}",
        remedy="give --nadir-angle and one --camera-height for one angle; leave --nadir-angle out "
        "for a table",
        options=options,
        other=other,
    )


def one_atmosphere_wanted() -> ConfigError:
    """A mission file and the name of an atmosphere are given, or neither."""
    return ConfigError(
        PROFILE_ARGUMENTS,
        "give either a mission file or --atmosphere",
        remedy="for example: --atmosphere us1976",
    )


def page_not_markdown(*, path: str, suffix: str) -> ConfigError:
    """The page of the comparison of methods is not called .md."""
    return ConfigError(
        PAGE_FORMAT,
        "the page is Markdown: its name must end in .md, not in {suffix}",
        where=path,
        remedy="the picture of the page gets the same name with .png",
        suffix=suffix or "nothing",
    )


def file_exists(*, path: str) -> ConfigError:
    """The mission file that `init` would write is there."""
    return ConfigError(
        INIT_EXISTS,
        "the file exists already",
        where=path,
        remedy="choose another name with --out, or replace it: --force",
    )


def no_place_for_compiled_code(*, path: str) -> StorageError:
    """Nothing can be compiled ahead, because no folder keeps it."""
    return StorageError(
        STORAGE_WRITE,
        "compiled code cannot be stored there",
        where=path,
        remedy="correct its permissions, or name another folder in NUMBA_CACHE_DIR",
    )
