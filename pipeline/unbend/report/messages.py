"""Refusals of `unbend help` and of plots, with the meanings of their codes."""

from unbend.errors import Code, ConfigError

HELP_WORD = Code(
    "HELP-WORD",
    means=(
        "`unbend help` does not know the word: it is not a key or a value of one, code, exit "
        "code, status, column of results or technical term."
    ),
    effect="Nothing is printed.",
    remedy="Use one of the similar words that the refusal names.",
)


def help_word(*, word: str, near: str) -> ConfigError:
    """A word has no explanation; ``near`` lists similar words that have one, or is empty."""
    remedy = "`unbend schema` has all keys; messages and refusals begin with their code"
    if near:
        remedy = "perhaps {near}?"
    return ConfigError(
        HELP_WORD,
        (
            "{word!r} is not a key of a mission file or a value of one, a code, an exit code, a "
            "status, a column of the results or a technical term"
        ),
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
    """The name of a plot has another ending than .png or .svg."""
    return ConfigError(
        PLOT_FORMAT,
        "a plot is written as .png or .svg",
        where=where,
        remedy="choose one of these endings",
    )
