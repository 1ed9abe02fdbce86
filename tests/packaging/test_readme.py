"""What the README promises stands in the project."""

import re
import tomllib
from importlib.metadata import entry_points
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_python_example_runs():
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names: dict[str, object] = {}
    assert len(example.splitlines()) <= 10
    exec(compile(example, "README.md", "exec"), names)
    assert names["info"]["distance"] > 0.15  # type: ignore[index]
    assert names["info"]["failure"] == "ok"  # type: ignore[index]


def test_every_subcommand_is_installed():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    installed = {e.name for e in entry_points(group="caterpillar.commands")}
    assert set(declared["entry-points"]["caterpillar.commands"]) <= installed
    for command in re.findall(r"^caterpillar (\w+)", README, flags=re.MULTILINE):
        assert command in installed


def test_readme_is_short():
    assert len(README.splitlines()) <= 200
