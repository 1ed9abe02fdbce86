"""The README is short, its Python example runs, and its commands exist."""

import re
import tomllib
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from caterpillar_env import Failure

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_python_example_reproduces_the_evolved_robot(tmp_path, monkeypatch, coarse):
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names = {}
    exec(compile(example, "README.md", "exec"), names)
    assert len(example.splitlines()) <= 12
    assert names["info"]["failure"] == Failure.NONE
    assert names["info"]["distance"] == names["robot"].fitness_m > 0


def test_every_subcommand_is_installed():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    installed = {e.name for e in entry_points(group="caterpillar.commands")}
    assert set(declared["entry-points"]["caterpillar.commands"]) <= installed
    for command in re.findall(r"^caterpillar (\w+)", README, flags=re.MULTILINE):
        assert command in installed


@pytest.mark.parametrize("marker", ["main-command", "test-command"])
def test_command_for_ci_is_one_shell_line(marker):
    (block,) = re.findall(rf"<!-- {marker} -->\n```sh\n(.*?)```", README, flags=re.DOTALL)
    assert len(block.splitlines()) == 1


def test_readme_is_short():
    assert len(README.splitlines()) <= 100
