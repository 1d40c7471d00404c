"""Texts for people (ledger, refusals, help, report) are in the third person and of plain words."""

import ast
import re
import tomllib

import pytest
import yaml

from tests.contract.sources import PACKAGE, ROOT, strings, text_of, trees

PERSON = re.compile(
    r"\b(?:you|your|yours|yourself|we|our|ours|ourselves|us|my|mine|myself|me)\b(?!-)|\bI\b(?!-)",
    re.IGNORECASE,
)
# "US 1976" is a standard atmosphere, "us" a microsecond after a number or in brackets.
NO_PERSON = re.compile(r"\bUS\b|\bi\b|\[[^]]*\bus\b[^]]*\]|[0-9] ?us\b")


def texts(tree: ast.Module):
    """Strings of a module with a space in them that are no docstrings: what somebody may read."""
    for line, text in strings(tree):
        if " " in text.strip():
            yield line, text


def persons_in(text):
    return PERSON.findall(NO_PERSON.sub("", text))


def test_texts_have_no_first_or_second_person():
    wrong = [
        f"{place}: {words} in {text.strip()[:80]!r}"
        for place, text in texts_of_the_program()
        if (words := persons_in(text))
    ]
    assert not wrong, "\n".join(wrong)


WITH_PERSONS = yaml.safe_load("""
- [name the sensor in your file, [your]]
- [We took what I found, [We, 'I']]
- [did you mean x, [you]]
- ['US 1976 errs by 0.3 K; the column i is in us [us]', [us]]
- ['1500 us late, time [us], minerals', []]
""")


@pytest.mark.parametrize(("text", "words"), WITH_PERSONS)
def test_persons_are_noticed(text, words):
    assert persons_in(text) == words


HABITS = {
    "X is no Y": r"(?<!there )\b(?:is|are|was|were) no\b(?! (?:longer|more|less|better)\b)",
    "is none": r"\b(?:is|are|was|were) none\b",
    "stands": r"\b(?:stands?|stood|standing)\b",
    "holds": r"\b(?:holds?|held(?!-out)|holding)\b",
    "says": r"\b(?:says?|said|saying|tells?|told)\b",
    "beside": r"\bbesides?\b",
    "of which": r"\b(?:of|by|from|with|through|about) which\b(?! image| event)",
    "whose": r"\bwhose\b",
    "lies": r"\b(?:lies?|lay|lying)\b",
    "mend": r"\bmend(?:s|ed|ing)?\b",
    "airs": r"\bairs\b",
    "drawn": r"\b(?:draws?|drew|drawn|drawings?)\b",
    "room": r"\brooms?\b",
    "as ever": r"\bas ever\b",
    "by itself": r"\bfound by (?:itself|themselves)\b",
    "Refused are": r"\b(?:Refused|Rejected|Reported|Taken) (?:is|are)\b",
    "whoever": r"\bwhoever\b",
    "private": r"\b(?:doubtful|believ\w*|betray\w*|widened|heed\w*|feign\w*|honest\w*)\b",
}
"""Habits of style that a reader with English as a second language stumbles over: name -> pattern.

In their place: is not, is in, contains, gives (a file, a value), next to, a second sentence, is
(at a place), correct, atmospheres, random, module, as usual, detected automatically. Private are
words of this program for what has a name in the field, as the sigma inflation factor.
"""
WHAT = re.compile(r"(?:^|(?<=[.;:!] ))What [^?.;]*[.;]")
"""A sentence with "What ..." as its subject, where the field has a noun; questions are none."""
MOST_WORDS = 100  # of a paragraph, or an item of a list
WIDEST_CODE = 80  # columns: a phone turned sideways, half a screen
NOT_OF_HAND = ("changelog.md", "changelog_details.md", "decisions.md", "accuracy.md", "codes.md")
"""Pages as they were at their time, or that the program writes."""
FENCED = re.compile(r"^( *)```(\w*)[^\n]*\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
WRITTEN_PAGES = [
    ROOT / "CONTRIBUTING.md",
    ROOT / "README.md",
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if page.name not in NOT_OF_HAND),
]


def prose_of(page):
    """A page without code, codes of messages, comments and the targets of links."""
    text = FENCED.sub("\n", page)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"`[^`]*`", "`code`", text)
    text = re.sub(r"\b[A-Z]+(?:-[A-Z]+)+\b", "CODE", text)
    return re.sub(r"\]\([^)]*\)", "]", text)


def paragraphs_of(page):
    """The paragraphs and items of lists of a page, each in one line; no headings, no tables."""
    paragraphs = []
    for block in re.split(r"\n\s*\n", prose_of(page)):
        if block.lstrip().startswith(("#", "|")):
            continue
        items = re.split(r"\n(?= *(?:[*+-]|\d+\.) )", block)
        paragraphs += [" ".join(item.split()).removeprefix("* ") for item in items]
    return paragraphs


def habits_in(page):
    """The habits of a page, each with the words around it."""
    text = " ".join(prose_of(page).split())
    found = [
        f"{name}: ...{text[max(0, hit.start() - 50) : hit.end() + 30]}..."
        for name, pattern in HABITS.items()
        for hit in re.finditer(pattern, text, re.IGNORECASE)
    ]
    subjects = [hit for line in paragraphs_of(page) for hit in WHAT.findall(line)]
    return found + [f"What as a subject: {sentence}" for sentence in subjects]


PROGRAM_HABITS = HABITS | {
    "own": r"\bof (?:its|their|one's) own\b",
    "anew": r"\banew\b",
    "for want of": r"\bfor want of\b",
    "taken for": r"\btaken (?:for|as)\b",
    "called like": r"\bcalled like\b",
    "as it does": r"\ball the same\b",
}
"""More habits that the texts of the program had: a different one, again, because there is no,
treated as, has a name like, still.
"""
JINJA = re.compile(r"\{%.*?%\}|\{\{.*?\}\}|\{#.*?#\}", re.DOTALL)
CODE_WORDS = re.compile(r"`[^`]*`|\{[^{}]*\}|\b\w+(?:[._]\w+)+\b|\b[A-Z]+(?:-[A-Z]+)+\b")
"""Keys, columns, codes and placeholders in a text: their names stay."""
NOT_SHOWN = (
    "atmosphere/data/air_variation.toml",
    "ingest/data/field_maps.toml",
    "simulate/data/dataflash.toml",
)
"""Tables for the program: no person sees their words."""


def strings_of_toml(value):
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for entry in value.values():
            yield from strings_of_toml(entry)
    elif isinstance(value, list):
        for entry in value:
            yield from strings_of_toml(entry)


def texts_of_the_program():
    """Place and text of all that a person may read: messages, keys, help, columns, words, report.

    Messages, labels and the reasons in them are strings with a space in the modules. The docstring
    of a command is its help, that of a section of the mission file is in the schema.
    """
    for place, tree in trees().items():
        for line, text in texts(tree):
            yield f"{place}:{line}", text
        for node in ast.walk(tree):
            is_command = isinstance(node, ast.FunctionDef) and node.decorator_list
            is_section = (
                isinstance(node, ast.ClassDef) and node.bases and place.startswith("config/")
            )
            if is_section or (is_command and place.startswith("cli/")):
                yield f"{place}:{node.lineno}", ast.get_docstring(node) or ""
    for path in sorted(PACKAGE.rglob("*.toml")):
        place = path.relative_to(PACKAGE).as_posix()
        if place not in NOT_SHOWN:
            for text in strings_of_toml(tomllib.loads(text_of(path))):
                yield place, text
    for path in sorted(PACKAGE.rglob("*.j2")):
        yield path.name, JINJA.sub(" ", text_of(path))


def habits_of_a_text(text):
    """The habits in a text of the program, whose names of keys and values are left out."""
    words = " ".join(CODE_WORDS.sub("X", text).split())
    return [
        f"{name}: ...{words[max(0, hit.start() - 40) : hit.end() + 30]}..."
        for name, pattern in PROGRAM_HABITS.items()
        for hit in re.finditer(pattern, words, re.IGNORECASE)
    ]


def test_texts_of_the_program_have_plain_words():
    wrong = [
        f"{place}: {habit}"
        for place, text in texts_of_the_program()
        for habit in habits_of_a_text(text)
    ]
    assert not wrong, "\n".join(wrong)


TEXTS_WITH_HABITS = yaml.safe_load("""
- ['the columns {columns} stand there twice', stands]
- ['is no IGRA file: it begins with {begins!r}', X is no Y]
- ['{count} points lie outside the area of {system}', lies]
- [give each mission a folder of its own, own]
- [levels are taken as saturated, taken for]
""")


@pytest.mark.parametrize(("text", "name"), TEXTS_WITH_HABITS)
def test_habits_of_the_program_are_noticed(text, name):
    assert any(found.startswith(name) for found in habits_of_a_text(text))


@pytest.mark.parametrize(
    "text",
    [
        "{mend}state {said} and {held}",
        "give cameras.<name>.window.holds",
        "PLAUSIBLE-LIES is not a code",
    ],
)
def test_names_in_texts_of_the_program_stay(text):
    assert not habits_of_a_text(text)


def test_all_kinds_of_texts_of_the_program_are_read():
    """The messages, the keys, the help, the columns, the words and the report."""
    read = " ".join(text for _, text in texts_of_the_program())
    for text in (
        "check the path of the log",
        "standard deviation of the heights of all points",
        "Correct missions. A refused mission",
        "print only refusals",
        "apparent nadir angle outside the window",
        "Ground control point",
        "How to use the results in the adjustment",
        "Ready for bundle adjustment",
    ):
        assert text in read


@pytest.mark.parametrize("page", WRITTEN_PAGES, ids=lambda page: page.name)
def test_a_page_has_plain_words(page):
    assert not habits_in(text_of(page))


@pytest.mark.parametrize("page", WRITTEN_PAGES, ids=lambda page: page.name)
def test_paragraphs_of_a_page_are_short(page):
    paragraphs = paragraphs_of(text_of(page))
    assert not [text for text in paragraphs if len(text.split()) > MOST_WORDS]


@pytest.mark.parametrize("page", WRITTEN_PAGES, ids=lambda page: page.name)
def test_code_of_a_page_fits_a_small_screen(page):
    """What the program printed (`console`) has the width that it was printed with."""
    text = text_of(page)
    fenced = [body for _, kind, body in FENCED.findall(text) if kind != "console"]
    indented = re.findall(r"^ {4}(?! *[|*]).*$", FENCED.sub("\n", text), re.MULTILINE)
    lines = [line for body in fenced for line in body.splitlines()] + indented
    assert not [line for line in lines if len(line) > WIDEST_CODE]


SENTENCES_WITH_HABITS = yaml.safe_load(r"""
- [It is no noise., X is no Y]
- [The causes stand in the ledger., stands]
- ["A file that holds several\ncameras.", holds]
- [The manifest says so., says]
- [The sidecar lies beside it., beside]
- [the sensor of which nothing is known, of which]
- [nine real airs, airs]
- [Honest thermometers with a widened sigma, private]
- ['* What is left stays in.', What as a subject]
""")


@pytest.mark.parametrize(("text", "name"), SENTENCES_WITH_HABITS)
def test_habits_are_noticed(text, name):
    assert any(found.startswith(name) for found in habits_in(text))


@pytest.mark.parametrize(
    "text",
    [
        "There is no key, and it is no longer there.",
        "## What `unbend export` writes\n\nFiles.",
        "**Is it gone? What then?** No.",
        "`beside` [the page](says.md#whose-airs)",
        "```console\n$ unbend check\nwhat it says\n```",
    ],
)
def test_other_words_are_no_habits(text):
    assert not habits_in(text)
