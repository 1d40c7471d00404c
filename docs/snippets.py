"""Runs what the pages show, and compares what they say it prints.

    python -m docs.snippets                   # all pages
    python -m docs.snippets --write PAGE...   # what is printed now takes the place of what is shown

In a block `console` the lines after `$ ` are run, and the lines below compared: `...` stands for
any text within a line, and alone for any number of lines. `$ echo $?` shows the exit code of the
line before; where it is not shown it must be 0. Lines that begin with `unbend` in a block `sh` are
run, too. A block with a title is written to the file of that name, mission files are loaded, blocks
`python` without a title executed. All this happens in a folder of the page, which has what
`<!-- given: flown -->` names. A block below `<!-- slow -->` is left out unless UNBEND_SNIPPETS=all.
"""

from __future__ import annotations

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

DOCS = Path(__file__).resolve().parent
REPOSITORY = DOCS.parent
FIRST = DOCS / "pages" / "first_flight.md"  # whose folder other pages go on in
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
    found = [REPOSITORY / "README.md", *DOCS.glob("*.md"), *(DOCS / "pages").rglob("*.md")]
    apart = {"changelog.md", "changelog_details.md", "decisions.md"}
    return sorted(
        page for page in found if page.name not in apart and any(b.runs for b in blocks(page))
    )


def blocks(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    for found in FENCE.finditer(text):
        title = TITLE.search(found["rest"])
        indent = found["indent"]
        body = re.sub(rf"^{indent}", "", found["body"], flags=re.M)
        before = text[: found.start()].rstrip().rsplit("\n", 1)[-1].strip()
        yield Block(
            found["kind"],
            title[1] if title else "",
            body,
            before == "<!-- slow -->",
            found.start("body"),
            found.end("body"),
            indent,
        )


def given(page: Path) -> list[str]:
    """What the folder of the page has from the beginning."""
    found = re.search(r"<!-- given: ([^>]*?) -->", page.read_text(encoding="utf-8"))
    return found[1].split(", ") if found else []


def printed_by(words: list[str]) -> tuple[str, int]:
    """Run `unbend` with these words, in this process: what it prints, and its exit code."""
    said = io.StringIO()
    kept = (sys.argv, sys.excepthook)
    sys.argv, code = ["unbend", *words], 0
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            unbend_main()
    except SystemExit as end:
        code = int(end.code or 0)
    finally:
        sys.argv, sys.excepthook = kept
    return said.getvalue(), code


def run_line(line: str) -> tuple[str, int]:
    """Run one line of a shell: `unbend`, `python FILE`, or one of a few others; pipes are known."""
    first, mark, rest = re.match(r"((?:'[^']*'|[^|>'])*)([|>]?)(.*)", line, re.S).groups()  # type: ignore[union-attr]
    words = shlex.split(first)
    if words[0] == "unbend":
        named = ([str(p) for p in sorted(Path().glob(w))] if "*" in w else [w] for w in words)
        words = [word for words in named for word in words]
        said, code = printed_by(words[1:])
    elif words[0] == "python":
        out = io.StringIO()
        kept = sys.argv
        sys.argv = words[1:]
        try:
            with contextlib.redirect_stdout(out):
                runpy.run_path(words[1], run_name="__main__")
        finally:
            sys.argv = kept
        said = out.getvalue()
        code = 0
    elif words[0] in SHELL:
        rest = ""
        mark = ""
        done = subprocess.run(line, shell=True, capture_output=True, text=True)
        said = done.stdout + done.stderr
        code = done.returncode
    else:
        raise ValueError(f"{line!r} is not run: write it in a block `sh`")
    if mark == "|":
        done = subprocess.run(rest, shell=True, input=said, capture_output=True, text=True)
        said = done.stdout + done.stderr
    elif mark == ">":
        Path(rest.strip()).write_text(said, encoding="utf-8")
        said = ""
    return said, code


def matches(shown: str, printed: str) -> bool:
    """Whether text is as shown: `...` alone stands for any lines, in a line for any text."""
    pattern = ""
    for line in shown.rstrip().splitlines():
        if line.strip() == "...":
            pattern += r"(?:[^\n]*\n)*?"
        else:
            parts = (re.escape(part) for part in line.rstrip().split("..."))
            pattern += "[^\n]*?".join(parts) + "\n"
    text = "".join(f"{line.rstrip()}\n" for line in printed.rstrip().splitlines())
    return re.fullmatch(pattern, text) is not None


def run_console(block: Block, differences: list[Difference]) -> None:
    """Run the lines of a block `console`, and note where it shows what is not printed."""
    code = 0
    parts = re.split(r"^(\$ .*(?:\\\n.*)*\n)", block.body, flags=re.M)
    commands = parts[1::2]
    outputs = parts[2::2]
    if parts[0].strip():
        raise ValueError(f"a block `console` begins with a line `$ ...`, not {parts[0]!r}")
    at = 0
    for number, (command, shown) in enumerate(zip(commands, outputs, strict=True)):
        line = command[2:].replace("\\\n", " ").strip()
        at = block.body.index(command, at) + len(command)
        if line == "echo $?":
            said = f"{code}\n"
        else:
            said, code = run_line(line)
            following = commands[number + 1][2:].strip() if number + 1 < len(commands) else ""
            if code and following != "echo $?":
                raise ValueError(f"{line!r} ends with {code}, which is not shown:\n{said}")
        if not matches(shown, said):
            differences.append(Difference(shown, said, at, at + len(shown)))
        at += len(shown)


def run_sh(block: Block) -> None:
    """Run the lines of a block `sh` that begin with `unbend`."""
    for line in block.body.replace("\\\n", " ").splitlines():
        line = line.split(" #")[0].strip()
        if line.startswith("unbend "):
            said, code = run_line(line)
            if code:
                raise ValueError(f"{line!r} ends with {code}:\n{said}")
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
    two = (REPOSITORY / "configs" / "sample_bin.yaml").read_text(encoding="utf-8")
    for base in filter(None, (whole, ONE_CAMERA)):
        with contextlib.suppress(UnbendError):
            load_text({**yaml.safe_load(base), **text})
            return whole
    load_text({**yaml.safe_load(two), **text})
    return whole


def load_text(text: dict[str, object]) -> None:
    """Load a mission file as `run` does; raises what is wrong with it."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "mission.yaml")
        file.write_text(yaml.safe_dump(text, sort_keys=False), encoding="utf-8")
        load_mission(file)


def run_page(page: Path, folder: Path, every: bool = False) -> list[tuple[Block, Difference]]:
    """Run all blocks of a page in a folder; an error of the page raises with its name."""
    found: list[tuple[Block, Difference]] = []
    whole = ""
    with contextlib.chdir(folder):
        for block in blocks(page):
            if block.slow and not every:
                continue
            differences: list[Difference] = []
            try:
                if block.title:
                    Path(block.title).parent.mkdir(parents=True, exist_ok=True)
                    Path(block.title).write_text(block.body, encoding="utf-8")
                if block.kind == "console":
                    run_console(block, differences)
                elif block.kind == "sh":
                    run_sh(block)
                elif block.kind == "yaml":
                    whole = load_yaml(block, whole)
                elif block.kind == "python" and not block.title and ">>>" not in block.body:
                    with contextlib.redirect_stdout(io.StringIO()):
                        exec(compile(block.body, str(page), "exec"), {"__name__": "__main__"})
            except BaseException as error:
                raise RuntimeError(f"{page}, in\n{block.body}\n{error}") from error
            found += [(block, difference) for difference in differences]
    return found


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
    if "first" in names:
        shutil.copytree(ready / "first", folder, dirs_exist_ok=True)
        names = [name for name in names if name != "first"]
    tops = {name.split("/")[0] for name in names}
    folder.mkdir(parents=True, exist_ok=True)
    for name in tops | ({"configs", "sample_logs"} if "results" in names else set()):
        without = () if f"{name}/results" in names else ("results",)
        shutil.copytree(ready / name, folder / name, ignore=shutil.ignore_patterns(*without))


def written(text: str, differences: list[tuple[Block, Difference]]) -> str:
    """A page with what is printed now; what ends with `...` keeps its number of lines."""
    for block in sorted({block for block, _ in differences}, key=lambda b: -b.start):
        body = block.body
        for difference in reversed([d for b, d in differences if b == block]):
            lines = [line.rstrip() for line in difference.printed.rstrip().splitlines()]
            shown = difference.shown.rstrip().splitlines()
            if shown and shown[-1].strip() == "...":
                lines = [*lines[: len(shown) - 1], "..."]
            new = "".join(f"{line}\n" for line in lines)
            body = body[: difference.start] + new + body[difference.end :]
        body = "".join(f"{block.indent}{line}\n" if line else "\n" for line in body.splitlines())
        text = text[: block.start] + body + text[block.end :]
    return text


def main() -> int:
    words = sys.argv[1:]
    write = "--write" in words
    named = [Path(word).resolve() for word in words if word[0] != "-"]
    every = os.environ.get("UNBEND_SNIPPETS") == "all"
    bad = 0
    os.environ["COLUMNS"] = "80"
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
            text = page.read_text(encoding="utf-8")
            page.write_text(written(text, differences), encoding="utf-8")
    shutil.rmtree(ready)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
