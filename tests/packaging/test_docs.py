"""The code blocks of the documentation run, its commands exist, and its links resolve."""

import ast
import re
import shlex
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import pytest

from evolution import cli
from evolution.study.config import read_toml

ROOT = Path(__file__).parents[2]
SITE = [page for page in sorted((ROOT / "docs").rglob("*.md")) if "_build" not in page.parts]
PAGES = [*SITE, *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"))]
#: Flags that shorten the commands of a page; they override earlier ones.
SHORT = {
    "evolve": "--generations 1 --population 4 --cma-population 4 --shade-population 4 "
    "--timestep-s 0.01 --no-video",
    "resume": "--generations 2 --no-video",
    "replay": "--speed 300 --width 128 --height 96",
    "view": "--help",  # the server would run until Ctrl-C
}


#: Replacements in the code of the pages, so that the tests simulate fewer robots and seconds.
FEWER = {"robots = 5.0, 24": "robots = 5.0, 2", "episode_s=10.0": "episode_s=5.0"}


class Block(NamedTuple):
    """A fenced block of code; `reason` is the comment before it that excludes it, if any."""

    reason: str
    language: str
    code: str

    @property
    def commands(self) -> list[list[str]]:
        """The words of each line of a shell block, without comments."""
        return [words for line in self.code.splitlines() if (words := shlex.split(line, comments=True))]


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def blocks(page: Path) -> list[Block]:
    comment = r"(?:<!-- (?:not run: )?((?<=not run: )[^\n]+|main-command|test-command) -->\n)?"
    found = re.findall(
        comment + r"^```([^\n]*)\n(.*?)^```$", text_of(page), flags=re.DOTALL | re.MULTILINE
    )
    return [Block(*parts) for parts in found]


def each(pages):
    return pytest.mark.parametrize("page", pages, ids=lambda page: str(page.relative_to(ROOT)))


def with_blocks(*languages):
    chosen = [p for p in PAGES if any(b.language in languages and not b.reason for b in blocks(p))]
    return each(chosen)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # libraries on the pages may warn
@with_blocks("python", "sh")
def test_code_blocks_of_the_page_run(page, tmp_path, monkeypatch, coarse):
    monkeypatch.chdir(tmp_path)
    for number, block in enumerate(b for b in blocks(page) if not b.reason):
        if block.language == "python":
            code = block.code
            for many, few in FEWER.items():
                code = code.replace(many, few)
            exec(compile(code, f"{page.name} {number}", "exec"), {"__name__": page.stem})
        elif block.language == "sh":
            for program, name, *rest in block.commands:
                assert program == "caterpillar", "a comment before the block must say why it is not run"
                assert cli.main([name, *rest, *SHORT.get(name, "").split()]) == 0


@each(PAGES)
def test_blocks_have_a_known_language(page):
    for block in blocks(page):
        assert block.language in (
            "python",
            "sh",
            "toml",
            "dockerfile",
            "{toctree}",
            "{only} page",
            "{only} not page",
            "{eval-rst}",
            "{include} ../CHANGELOG.md",
        ), block


@each([page for page in PAGES if any("tests/" in block.reason for block in blocks(page))])
def test_excluded_blocks_name_tests_that_exist(page):
    for block in blocks(page):
        for file, function in re.findall(r"(tests/[\w/.]+\w)(?:::(\w+))?", block.reason):
            assert (ROOT / file).exists(), file
            if function:
                tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
                assert function in {n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)}


@with_blocks("toml")
def test_studies_in_the_docs_can_be_run(page, tmp_path):
    for block in blocks(page):
        if block.language == "toml":
            (tmp_path / "study.toml").write_text(block.code)
            assert len(read_toml(tmp_path / "study.toml").cells()) > 1


@each([p for p in PAGES if "\ncaterpillar " in text_of(p)])
def test_commands_and_their_flags_exist(page, capsys):
    lines = [words for block in blocks(page) for words in block.commands if block.language == "sh"]
    for name, *rest in (words[1:] for words in lines if words[0] == "caterpillar"):
        part = rest[:1] if name == "rl" else []
        assert cli.main([name, *part, "--help"]) == 0
        output = capsys.readouterr().out
        for flag in (word for word in rest if word.startswith("--")):
            assert flag in output, (name, flag)


def anchors(page: Path) -> set[str]:
    """The anchors of headings, by GitHub's rule."""
    prose = re.sub(r"^```.*?^```$", "", text_of(page), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#+ (.+)$", prose, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).strip().replace(" ", "-") for h in headings}


@each(PAGES)
def test_links_resolve(page):
    targets = re.findall(r"\]\(([^)\s]+)\)", text_of(page))
    for target in targets:
        parts = urlsplit(target)
        if parts.scheme:
            assert parts.scheme == "https", target
            assert re.fullmatch(r"[\w-]+(\.[\w-]+)+", parts.netloc), target
            continue
        file = page.parent / parts.path if parts.path else page
        assert file.exists(), target
        if parts.fragment:
            assert parts.fragment in anchors(file), target


def test_every_page_is_in_the_contents():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    contents = {
        entry
        for tree in re.findall(r"```{toctree}\n(.*?)```", index, flags=re.DOTALL)
        for entry in tree.split()
        if not entry.startswith(":")
    }
    pages = {str(page.relative_to(ROOT / "docs").with_suffix("")) for page in SITE} - {"index"}
    assert pages <= contents
