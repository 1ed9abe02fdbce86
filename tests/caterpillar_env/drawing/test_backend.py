"""Importing the package chooses how to draw where there is no display."""

import ctypes
import os
import subprocess
import sys

import pytest

from caterpillar_env.drawing import backend


@pytest.mark.parametrize(
    ("found", "egl_works", "chosen"),
    [
        ({"EGL"}, True, "egl"),
        ({"EGL"}, False, "egl"),  # nothing else to be had: drawing says why not
        ({"EGL", "OSMesa"}, True, "egl"),
        ({"EGL", "OSMesa"}, False, "osmesa"),
        ({"OSMesa"}, False, "osmesa"),
        (set(), False, "disabled"),
    ],
)
def test_egl_comes_first_then_osmesa(found, egl_works, chosen, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)
    libraries = {
        f"lib{name}.so.{number}" for name, number in (("EGL", 1), ("OSMesa", 8)) if name in found
    }
    monkeypatch.setattr(backend, "_library", lambda name: name if name in libraries else None)
    monkeypatch.setattr(backend, "_works", lambda egl: egl_works)
    backend.choose()
    assert os.environ["MUJOCO_GL"] == chosen


@pytest.mark.parametrize("name", ["DISPLAY", "MUJOCO_GL"])
def test_display_and_own_choice_are_left_alone(name, monkeypatch):
    for other in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv(name, "mine")
    before = os.environ.get("MUJOCO_GL")
    backend.choose()
    assert os.environ.get("MUJOCO_GL") == before


@pytest.mark.skipif(sys.platform != "linux", reason="EGL is of Linux")
def test_egl_without_a_driver_is_seen_not_to_work():
    code = (
        "import ctypes; from caterpillar_env.drawing import backend; "
        "print(int(backend._works(ctypes.CDLL('libEGL.so.1'))))"
    )
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError:
        pytest.skip("no EGL here")
    here = {**os.environ, "MUJOCO_GL": "egl"}
    bare = {
        **here,
        "__EGL_VENDOR_LIBRARY_FILENAMES": "/nowhere",
        "__EGL_VENDOR_LIBRARY_DIRS": "/nowhere",
    }
    said = [
        subprocess.run(
            [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
        ).stdout
        for env in (here, bare)
    ]
    assert said == ["1\n", "0\n"]
