"""Tables and lists that a test expects, as texts in which they can be read."""


def lines_of(text):
    """The lines of a text, without indentation and without empty ones."""
    lines = map(str.strip, text.splitlines())
    return [line for line in lines if line]


def rows_of(text):
    """The cells of a table whose rows are lines, with a bar between two cells.

    >>> rows_of("belly | 61 px")
    [['belly', '61 px']]
    """
    rows = []
    for line in lines_of(text):
        cells = map(str.strip, line.split("|"))
        rows.append(list(cells))
    return rows
