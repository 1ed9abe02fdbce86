"""Rendering without a display uses EGL or OSMesa. Importing changes no environment variable."""

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


@pytest.mark.parametrize(
    ("found", "egl_works", "chosen"),
    [
        ({"EGL"}, True, "egl"),
        ({"EGL"}, False, "egl"),  # the only backend; drawing reports why it fails
        ({"EGL", "OSMesa"}, True, "egl"),
        ({"EGL", "OSMesa"}, False, "osmesa"),
        ({"OSMesa"}, False, "osmesa"),
        (set(), False, "disabled"),
    ],
)
def test_egl_is_preferred_to_osmesa(found, egl_works, chosen, headless, monkeypatch):
    libraries = {
        f"lib{name}.so.{number}" for name, number in (("EGL", 1), ("OSMesa", 8)) if name in found
    }
    monkeypatch.setattr(backend, "_has_library", libraries.__contains__)
    monkeypatch.setattr(backend, "_egl_works", lambda: egl_works)
    assert backend.choose_backend() == chosen


@pytest.mark.parametrize(("name", "chosen"), [("DISPLAY", "glfw"), ("MUJOCO_GL", "mine")])
def test_display_and_environment_variable_take_precedence(name, chosen, headless, monkeypatch):
    monkeypatch.setenv(name, "mine")
    assert backend.choose_backend() == chosen


@pytest.mark.drawing
@pytest.mark.skipif(sys.platform != "linux", reason="EGL exists on Linux only")
def test_egl_without_a_driver_does_not_work(headless, monkeypatch):
    if backend.choose_backend() != "egl":
        pytest.skip("EGL is not installed")
    assert backend._egl_works()
    for name in ("FILENAMES", "DIRS"):
        monkeypatch.setenv(f"__EGL_VENDOR_LIBRARY_{name}", "/nowhere")
    assert not backend._egl_works()


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
