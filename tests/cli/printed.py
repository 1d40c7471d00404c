"""What commands print, as tests read it."""

import json


def longest(text):
    """The most characters of a line."""
    return max(len(line.rstrip()) for line in text.splitlines())


def strict_json(text):
    """JSON as its standard has it: NaN and Infinity are no numbers."""

    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)
