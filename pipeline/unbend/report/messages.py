"""Messages of report: what each code means, and the words of what is sent."""

from unbend.errors import Code, ConfigError

HELP_WORD = Code(
    "HELP-WORD",
    means="`unbend help` was asked for a word that is no key, code, exit code, status, column of "
    "results or word of the field.",
    effect="Nothing is printed.",
    remedy="Take one of the nearest words that the refusal names.",
)


def help_word(*, word: str, near: str) -> ConfigError:
    """A word that is explained nowhere; ``near`` are words like it, or none."""
    remedy = "`unbend schema` has all keys; codes are what the ledger and refusals begin with"
    if near:
        remedy = "perhaps {near}?"
    return ConfigError(
        HELP_WORD,
        "{word!r} is no key of a mission file, no code, exit code or status, no column of results "
        "and no word of the field",
        remedy=remedy,
        word=word,
        near=near,
    )


PLOT_FORMAT = Code(
    "PLOT-FORMAT",
    means="A plot is written as .png or .svg.",
    effect="The command is refused.",
    remedy="Choose one of these endings.",
)


def plot_format(*, where: object) -> ConfigError:
    """A plot is written as .png or .svg."""
    return ConfigError(
        PLOT_FORMAT,
        "a plot is written as .png or .svg",
        where=where,
        remedy="choose one of these endings",
    )
