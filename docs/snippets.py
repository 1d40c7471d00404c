"""Runs what the pages show, and compares what they say it prints.

    python -m docs.snippets                   # all pages
    python -m docs.snippets --write PAGE...   # what is printed now takes the place of what is shown

In a block `console` the lines after `$ ` are run, and the lines below compared: `...` stands for
any text within a line, and alone for any number of lines. `$ echo $?` shows the exit code of the
line before; where it is not shown it must be 0. Lines that begin with `unbend` in a block `sh` are
run, too. A block with a title is written to the file of that name, mission files are loaded. Blocks
`python` without a title are executed with the names of those before. All this happens in a folder
of the page, which has what `<!-- given: flown -->` names. A block below
`<!-- slow -->` is left out unless UNBEND_SNIPPETS=all.
"""

import contextlib
import io
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml

from unbend.cli import main as unbend_main
from unbend.config import load_mission
from unbend.config.campaign import campaign_of
from unbend.errors import UnbendError
from unbend.report.words import hanging

DOCS = Path(__file__).resolve().parent
REPOSITORY = DOCS.parent
FIRST = DOCS / "pages" / "first_flight.md"  # whose folder other pages go on in
NUMBER = re.compile(r"\d[\d,]*\.\d+")
COLUMNS = 80  # of the terminal that the pages show
MESSAGE = re.compile(r" *(?:[a-z]+ +)?(?:[A-Z][A-Z0-9]*(?:-[A-Z0-9]+)+|to do|where):")
"""The beginning of a message with its code, or of its remedy or its place."""
SMALL = 2e-5
FENCE = re.compile(
    r"^(?P<indent> *)```(?P<kind>\w*)(?P<rest>[^\n]*)\n(?P<body>.*?)^(?P=indent)```", re.M | re.S
)
TITLE = re.compile(r'title="([^"]+)"')
SHELL = ("cat", "cp", "grep", "head", "ls", "mkdir", "rm", "tail", "touch", "wc")  # run as such
NOT_RUN = ("#", "cd ", "env/", "exiftool ", "git ", "make", "pip ", "py", "python -m")
ONE_CAMERA = """
mission: {name: one}
log: {path: flight.bin}
observations: {path: observations.csv}
cameras:
  nadir: {width_px: 14000, height_px: 10600, f_px: 20000.0, cx_px: 7000.0, cy_px: 5300.0,
          calibration: laboratory}
mount: {nadir: {}}
events: {log: {nadir: {image: "*"}}}
ground: {height: {column: h_g_m}, reference: msl}
output: {path: results/one}
"""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page, without its indentation."""

    kind: str
    title: str
    body: str
    slow: bool
    start: int
    end: int
    indent: str

    @property
    def runs(self) -> bool:
        """Whether something happens with it."""
        return bool(self.title) or self.kind in ("console", "sh", "yaml", "python")

    @property
    def is_program(self) -> bool:
        """Whether it is Python to run: neither a file nor a session of the interpreter."""
        return self.kind == "python" and not self.title and ">>>" not in self.body


@dataclass(frozen=True)
class Difference:
    """What a page shows (from `start` to `end` of its text) and what is printed."""

    shown: str
    printed: str
    start: int
    end: int


FOUND: dict[Path, list[tuple[Block, Difference]]] = {}  # on the page of the first flight


def pages() -> list[Path]:
    """All pages with something to run."""
    not_run = {"changelog.md", "changelog_details.md", "decisions.md"}
    with_blocks = []
    for page in (REPOSITORY / "README.md", *DOCS.glob("*.md"), *DOCS.glob("pages/**/*.md")):
        if page.name not in not_run and any(block.runs for block in blocks(page)):
            with_blocks.append(page)
    return sorted(with_blocks)


def blocks(page: Path) -> Iterator[Block]:
    text = page.read_text("utf-8")
    for fence in FENCE.finditer(text):
        title = ""
        stated = TITLE.search(fence["rest"])
        if stated:
            title = stated[1]
        indent = fence["indent"]
        before = text[: fence.start()].rstrip()
        yield Block(
            kind=fence["kind"],
            title=title,
            body=re.sub(rf"^{indent}", "", fence["body"], flags=re.M),
            slow=before.endswith("<!-- slow -->"),
            start=fence.start("body"),
            end=fence.end("body"),
            indent=indent,
        )


def given(page: Path) -> list[str]:
    """What the folder of the page has from the beginning."""
    comment = re.search(r"<!-- given: ([^>]*?) -->", page.read_text("utf-8"))
    if comment is None:
        return []
    return comment[1].split(", ")


@contextlib.contextmanager
def arguments(words: list[str]) -> Iterator[io.StringIO]:
    """`sys.argv` for a program in this process; what it prints."""
    printed = io.StringIO()
    before = (sys.argv, sys.excepthook)
    sys.argv = words
    try:
        with contextlib.redirect_stdout(printed):
            yield printed
    finally:
        sys.argv, sys.excepthook = before


def printed_by(words: list[str]) -> tuple[str, int]:
    """Run `unbend` with these words, in this process: what it prints, and its exit code."""
    code = 0
    with arguments(["unbend", *words]) as printed, contextlib.redirect_stderr(printed):
        try:
            unbend_main()
        except SystemExit as end:
            code = int(end.code or 0)
    return printed.getvalue(), code


def run_shell(line: str, text: str | None = None) -> tuple[str, int]:
    """Run a line by a shell, with a text as its input."""
    ended = subprocess.run(line, shell=True, input=text, capture_output=True, text=True)
    return ended.stdout + ended.stderr, ended.returncode


def with_names(words: list[str]) -> list[str]:
    """Words of a shell, with the names of files in the place of patterns."""
    names = []
    for word in words:
        if "*" in word:
            names += sorted(str(path) for path in Path().glob(word))
        else:
            names.append(word)
    return names


def run_line(line: str) -> tuple[str, int]:
    """Run one line of a shell: `unbend`, `python FILE`, or one of a few others; pipes are known."""
    if line.split()[0] in SHELL:
        return run_shell(line)
    parts = re.match(r"((?:'[^']*'|[^|>'])*)([|>]?)(.*)", line, re.S)
    assert parts is not None  # it matches any text
    command, mark, target = parts.groups()
    program, *words = shlex.split(command)
    code = 0
    if program == "unbend":
        text, code = printed_by(with_names(words))
    elif program == "python":
        with arguments(words) as printed:
            runpy.run_path(words[0], run_name="__main__")
        text = printed.getvalue()
    else:
        raise ValueError(f"{line!r} is not run: write it in a block `sh`")
    if mark == "|":
        text, _ = run_shell(target, text)
    elif mark == ">":
        Path(target.strip()).write_text(text, "utf-8")
        text = ""
    return text, code


def matches(shown: str, printed: str) -> bool:
    """Whether text is as shown: `...` alone stands for any lines, in a line for any text.

    Numbers with a decimal point are as shown if they are `alike`.
    """
    pattern = ""
    for line in shown.rstrip().splitlines():
        if line.strip() == "...":
            pattern += r"(?:[^\n]*\n)*?"
        else:
            parts = map(with_any_numbers, line.rstrip().split("..."))
            pattern += "[^\n]*?".join(parts) + "\n"
    text = "".join(f"{line}\n" for line in lines_of(printed))
    match = re.fullmatch(pattern, text)
    if match is None:
        return False
    numbers = NUMBER.findall(re.sub(r"\.{3}", " ", shown))
    return all(map(alike, numbers, match.groups()))


def with_any_numbers(text: str) -> str:
    """A pattern of a text in which its numbers may be others: each is a group."""
    others = map(re.escape, NUMBER.split(text))
    return f"({NUMBER.pattern})".join(others)


def alike(shown: str, printed: str) -> bool:
    """Whether two numbers differ by a unit of the last digit shown at most, or by `SMALL`.

    Processors round the logarithms of a simulated flight differently: a few of its readings then
    differ by a unit, which moves corrected coordinates by 1e-5 px.

    >>> alike("10.05", "10.06"), alike("10.05", "10.07"), alike("8495.002484", "8495.002476")
    (True, False, True)
    """
    decimals = len(shown.partition(".")[2])
    unit = 10.0**-decimals
    difference = abs(float(shown.replace(",", "")) - float(printed.replace(",", "")))
    return difference <= max(1.01 * unit, SMALL)


def lines_of(text: str) -> list[str]:
    """Lines without spaces at their ends, and without empty ones at the end of all."""
    return [line.rstrip() for line in text.rstrip().splitlines()]


def run_console(block: Block, differences: list[Difference]) -> None:
    """Run the lines of a block `console`, and note where it shows what is not printed."""
    before, *parts = re.split(r"^(\$ .*(?:\\\n.*)*\n)", block.body, flags=re.M)
    if before.strip():
        raise ValueError(f"a block `console` begins with a line `$ ...`, not {before!r}")
    code = 0
    end = len(before)
    commands = [part[2:].replace("\\\n", " ").strip() for part in parts[::2]]
    for number, line in enumerate(commands):
        command, shown = parts[2 * number : 2 * number + 2]
        start = end + len(command)
        end = start + len(shown)
        if line == "echo $?":
            printed = f"{code}\n"
        else:
            printed, code = run_line(line)
            if line.startswith("unbend "):
                printed = as_in_terminal(printed)
            code_is_shown = commands[number + 1 : number + 2] == ["echo $?"]
            if code and not code_is_shown:
                raise ValueError(f"{line!r} ends with {code}, which is not shown:\n{printed}")
        if not matches(shown, printed):
            differences.append(Difference(shown, printed, start, end))


def as_in_terminal(text: str) -> str:
    """Messages of a command wrapped as in a terminal of 80 columns; other lines stay whole."""
    shown = []
    for line in text.splitlines():
        if MESSAGE.match(line):
            line = hanging(line, COLUMNS)
        shown.append(line)
    return "".join(f"{line}\n" for line in shown)


def run_sh(block: Block) -> None:
    """Run the lines of a block `sh` that begin with `unbend`."""
    for line in block.body.replace("\\\n", " ").splitlines():
        line = line.split(" #")[0].strip()
        if line.startswith("unbend "):
            printed, code = run_line(line)
            if code:
                raise ValueError(f"{line!r} ends with {code}:\n{printed}")
        elif not line.startswith(NOT_RUN) and line:
            raise ValueError(f"{line!r} is not run, and not known as a line of another program")


def load_yaml(block: Block, whole: str) -> str:
    """Load a mission file, or a part of one together with what a mission of the page, of one camera
    or of two has besides; returns the page's mission file."""
    text = yaml.safe_load(block.body)
    if not isinstance(text, dict):
        raise ValueError(f"not a part of a mission file: {block.body}")
    if "campaign" in text:
        campaign_of(Path("season.yaml"), text, yaml.compose(block.body))
        return whole
    if "cameras" in text and "output" in text:
        load_text(text)
        return block.body
    for mission in filter(None, (whole, ONE_CAMERA)):
        with contextlib.suppress(UnbendError):
            load_text(yaml.safe_load(mission) | text)
            return whole
    of_two_cameras = (REPOSITORY / "configs" / "sample_bin.yaml").read_text("utf-8")
    load_text(yaml.safe_load(of_two_cameras) | text)
    return whole


def load_text(text: dict[str, object]) -> None:
    """Load a mission file as `run` does; raises what is wrong with it."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "mission.yaml")
        file.write_text(yaml.safe_dump(text, sort_keys=False), "utf-8")
        load_mission(file)


def run_page(page: Path, folder: Path, every: bool = False) -> list[tuple[Block, Difference]]:
    """Run all blocks of a page in a folder; an error of the page raises with its name."""
    differences: list[tuple[Block, Difference]] = []
    whole = ""
    names: dict[str, object] = {"__name__": "__main__"}
    with contextlib.chdir(folder):
        for block in blocks(page):
            if block.slow and not every:
                continue
            of_block: list[Difference] = []
            try:
                if block.is_program:
                    run_program(block, page, names)
                else:
                    whole = run_block(block, whole, of_block)
            except BaseException as error:
                raise RuntimeError(f"{page}, in\n{block.body}\n{error}") from error
            differences += [(block, difference) for difference in of_block]
    return differences


def run_program(block: Block, page: Path, names: dict[str, object]) -> None:
    """Run a block of Python that is no file, with the names of the blocks before it."""
    program = compile(block.body, str(page), "exec")
    with contextlib.redirect_stdout(io.StringIO()):
        exec(program, names)


def run_block(block: Block, whole: str, differences: list[Difference]) -> str:
    """Run one block, or write its file; returns the page's mission file."""
    if block.title:
        file = Path(block.title)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(block.body, "utf-8")
    if block.kind == "console":
        run_console(block, differences)
    elif block.kind == "sh":
        run_sh(block)
    elif block.kind == "yaml":
        return load_yaml(block, whole)
    return whole


def make_given(folder: Path, names: list[str]) -> None:
    """Make what pages start with; `first` is the folder of the first flight after its page."""
    for name in names:
        if (folder / name).exists():
            continue
        if name == "first":
            copy_given(folder, folder / name, given(FIRST))
            FOUND[folder] = run_page(FIRST, folder / name)
        elif name == "flown":
            printed_by(["simulate", str(folder / "flown")])
        elif name == "flown/results":
            make_given(folder, ["flown"])
            printed_by(["run", str(folder / "flown" / "mission_bin.yaml")])
        elif name in ("configs", "sample_logs"):
            shutil.copytree(REPOSITORY / name, folder / name)
        elif name == "results":
            make_given(folder, ["configs", "sample_logs"])
            printed_by(["run", str(folder / "configs" / "sample_bin.yaml")])
        else:
            raise ValueError(f"nothing is known as {name!r}")


def run_alone(page: Path, ready: Path, folder: Path, every: bool) -> list[tuple[Block, Difference]]:
    """Run a page in a folder of its own; the first flight only once."""
    if page == FIRST and not every:
        make_given(ready, ["first"])
        return FOUND[ready]
    copy_given(ready, folder, given(page))
    return run_page(page, folder, every)


def copy_given(ready: Path, folder: Path, names: list[str]) -> None:
    """A page's own copy of what it starts with."""
    make_given(ready, names)
    folders = {name.split("/")[0] for name in names}
    if "first" in folders:
        shutil.copytree(ready / "first", folder, dirs_exist_ok=True)
        folders.remove("first")
    if "results" in folders:
        folders |= {"configs", "sample_logs"}
    folder.mkdir(parents=True, exist_ok=True)
    for name in folders:
        ignored = shutil.ignore_patterns("results")
        if f"{name}/results" in names:
            ignored = None
        shutil.copytree(ready / name, folder / name, ignore=ignored)


def written(text: str, differences: list[tuple[Block, Difference]]) -> str:
    """A page with what is printed now; what ends with `...` keeps its number of lines."""
    by_block: dict[Block, list[Difference]] = {}
    for block, difference in differences:
        by_block.setdefault(block, []).append(difference)
    for block, of_block in reversed(by_block.items()):  # from the end: places before stay
        body = block.body
        for difference in reversed(of_block):
            lines = lines_of(difference.printed)
            shown = difference.shown.rstrip().splitlines()
            if shown and shown[-1].strip() == "...":
                lines = [*lines[: len(shown) - 1], "..."]
            printed = "".join(f"{line}\n" for line in lines)
            body = body[: difference.start] + printed + body[difference.end :]
        text = text[: block.start] + indented(body, block.indent) + text[block.end :]
    return text


def indented(body: str, indent: str) -> str:
    """Lines of a block as the page has them."""
    text = ""
    for line in body.splitlines():
        if line:
            text += indent
        text += f"{line}\n"
    return text


def main() -> int:
    words = sys.argv[1:]
    write = "--write" in words
    named = [Path(word).resolve() for word in words if word[0] != "-"]
    every = os.environ.get("UNBEND_SNIPPETS") == "all"
    bad = 0
    os.environ["COLUMNS"] = str(COLUMNS)
    ready = Path(tempfile.mkdtemp())
    for page in named or pages():
        if not every and not any(block.runs and not block.slow for block in blocks(page)):
            continue
        folder = Path(tempfile.mkdtemp())
        begun = time.process_time()
        try:
            differences = run_alone(page, ready, folder, every)
        except RuntimeError as error:
            print(error)
            bad += 1
            continue
        finally:
            shutil.rmtree(folder)
            print(f"{page.relative_to(REPOSITORY)}: {time.process_time() - begun:.1f} s of CPU")
        for _, difference in differences:
            print(f"{page}\n--- shown\n{difference.shown}--- printed\n{difference.printed}")
        bad += len(differences)
        if write and differences:
            text = page.read_text("utf-8")
            page.write_text(written(text, differences), "utf-8")
    shutil.rmtree(ready)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
