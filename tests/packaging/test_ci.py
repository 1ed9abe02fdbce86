"""The script of all checks runs each check, and fails if a check fails."""

import os
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
#: Stub for every program. It records its call, and fails if the call contains $BROKEN.
STUB = """#!/bin/sh
call="$(basename "$0") $*"
echo "$call" >> "$CALLS"
case "$call" in
    "python3 -m venv"*) mkdir -p "$3/bin" && cp "$0" "$3/bin/pip" && cp "$0" "$3/bin/python" ;;
esac
case "$call" in
    *"$BROKEN"*) exit 1 ;;
esac
"""
STEPS = [
    "python -m pytest -q -n 2", "python -m pytest -q -m slow", "ruff check .", "ruff format --check .",
    "mypy", "lint-imports", "sphinx-build -W", "python -m build --wheel", "python3 -m venv",
    "pip install -q", "python smoke.py",
]  # fmt: skip


@pytest.fixture
def ci(tmp_path):
    """Return a function that runs the script with stubs for the programs that it calls."""
    for folder in (".ci", "bin", "tests/packaging"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / ".ci" / "run").write_text((ROOT / ".ci" / "run").read_text("utf-8"))
    (tmp_path / "tests" / "packaging" / "smoke.py").touch()
    (tmp_path / "README.md").write_text(
        "<!-- test-command -->\n```sh\n"
        "mkdir .venv && cp -r bin .venv/bin && .venv/bin/python -m pytest -q -n 2\n```\n"
    )
    for name in ("python", "python3", "pip", "ruff", "mypy", "lint-imports", "sphinx-build", "apt-get",
                 "ldconfig", "chromium", "id", "sudo"):  # fmt: skip
        (tmp_path / "bin" / name).write_text(STUB)
        (tmp_path / "bin" / name).chmod(0o755)

    def run(broken):
        calls = tmp_path / "calls"
        calls.touch()
        env = {**os.environ, "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"}
        done = subprocess.run(
            ["bash", tmp_path / ".ci" / "run"], env={**env, "CALLS": str(calls), "BROKEN": broken},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        return done, calls.read_text()

    return run


def test_every_check_runs(ci):
    done, calls = ci("no such call")
    assert done.returncode == 0, done.stderr
    assert "== done" in done.stdout
    assert [step for step in STEPS if step not in calls] == []
    assert "sudo -n apt-get install -y -qq libegl1" in calls  # the `id` stub does not print 0


def test_checks_continue_without_system_packages(ci):
    done, _ = ci("apt-get update")
    assert done.returncode == 0, done.stderr
    assert "no EGL here: tests that draw are skipped" in done.stdout


@pytest.mark.parametrize("step", STEPS)
def test_script_stops_at_a_failing_check(ci, step):
    done, calls = ci(step)
    assert done.returncode != 0
    assert "== done" not in done.stdout
    assert step in calls


def test_citation_and_changelog_have_the_version_of_the_package():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["version"] == version
    assert citation["license"] == "MIT"
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text("utf-8")


def test_workflow_runs_the_script_of_all_checks():
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text("utf-8"))
    assert workflow["jobs"]["test"]["steps"][-1] == {"run": ".ci/run"}
