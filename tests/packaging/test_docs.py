"""What the documentation shows can be run."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = [
    (page.name, number, code)
    for page in sorted((ROOT / "docs").glob("*.md"))
    for number, code in enumerate(
        re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    )
]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the libraries that the examples show
@pytest.mark.parametrize(("page", "number", "code"), EXAMPLES, ids=lambda value: str(value)[:20])
def test_example_runs(page, number, code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(code, f"{page} {number}", "exec"), {"__name__": page})


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda page: page.name)
def test_links_and_pictures_exist(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?://)([^)#]+)\)", text):
        assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda page: page.name)
def test_commands_and_their_flags_exist(page, capsys):
    from evolution import cli

    for line in re.findall(r"^caterpillar (.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE):
        name, *rest = line.split("#")[0].split()
        assert cli.main([name, "--help"]) == 0
        told = capsys.readouterr().out
        for flag in (word for word in rest if word.startswith("--")):
            assert flag in told, line


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda page: page.name)
def test_studies_in_the_docs_can_be_run(page, tmp_path):
    from evolution.study import read_toml

    for text in re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL):
        (tmp_path / "study.toml").write_text(text)
        assert len(read_toml(tmp_path / "study.toml").cells()) > 1
