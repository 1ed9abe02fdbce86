"""Rendering without a display uses EGL. Importing changes no environment variable."""

import os
import subprocess
import sys

import pytest

from caterpillar_env.drawing import backend

VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")


@pytest.fixture
def headless(monkeypatch):
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)


def test_default_is_egl(headless):
    assert backend.choose_backend() == "egl"


@pytest.mark.parametrize(("name", "chosen"), [("DISPLAY", "glfw"), ("MUJOCO_GL", "mine")])
def test_display_and_environment_variable_take_precedence(name, chosen, headless, monkeypatch):
    monkeypatch.setenv(name, "mine")
    assert backend.choose_backend() == chosen


def run(code):
    """Run a program without a display and without MUJOCO_GL."""
    environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)


def test_importing_changes_no_environment_variable():
    run(
        "import gymnasium, os\n"  # Gymnasium sets its own variable
        "before = dict(os.environ)\n"
        "import caterpillar_env.env, caterpillar_env.drawing.video\n"
        "assert dict(os.environ) == before"
    )


@pytest.mark.drawing
def test_rendering_works_without_a_display_after_importing_mujoco():
    run(
        "import mujoco, caterpillar_env\n"
        "env = caterpillar_env.CaterpillarEnv(render_mode='rgb_array', width=64, height=48)\n"
        "env.reset(seed=0)\n"
        "assert env.render().std() > 10"
    )
