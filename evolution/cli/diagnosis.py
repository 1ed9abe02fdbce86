"""What is installed, whether drawing works, and how fast this machine is.

Nothing here imports MuJoCo: it is tried in processes of its own, whose crash is a finding.
"""

from __future__ import annotations

import json
import math
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from pathlib import Path
from typing import Any, Literal, NamedTuple

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from caterpillar_env import machine
from caterpillar_env.drawing.backend import INSTALL_DRAWING

PACKAGE = "caterpillar-sma"
Status = Literal["ok", "note", "fail"]  #: note: something that not every run needs does not work
_FOR_DEVELOPERS = ("test", "docs")
_PATIENCE_S = 120.0
_BACKENDS: tuple[str | None, ...] = (None, "egl", "osmesa")


class Finding(NamedTuple):
    """What is known of one thing."""

    name: str
    status: Status
    found: str
    mend: str = ""  #: what to do about it


def installed() -> Iterator[Finding]:
    """Python, this package, what it needs, and its extras."""
    wanted = SpecifierSet(metadata(PACKAGE)["Requires-Python"])
    running = platform.python_version()
    fits = wanted.contains(running, prereleases=True)
    yield Finding(
        "Python", "ok" if fits else "fail", f"{running}, {sys.executable}",
        "" if fits else f"needs Python {wanted}",
    )  # fmt: skip
    yield Finding(PACKAGE, "ok", f"{version(PACKAGE)}, {Path(__file__).resolve().parents[1]}")
    every = [Requirement(text) for text in requires(PACKAGE) or []]
    fits_here = [r for r in every if r.marker is None or r.marker.evaluate({"extra": ""})]
    yield from required(fits_here)
    for extra in metadata(PACKAGE).get_all("Provides-Extra") or []:
        if extra not in _FOR_DEVELOPERS:
            its = [r for r in every if r.marker is not None and r.marker.evaluate({"extra": extra})]
            yield of_extra(extra, [r for r in its if r not in fits_here])


def required(requirements: Sequence[Requirement]) -> Iterator[Finding]:
    """What every run needs: one line if all is well, else one for each that is not."""
    versions = {r.name: _installed(r.name) for r in requirements}
    bad = [r for r in requirements if not _fits(r, versions[r.name])]
    good = ", ".join(f"{r.name} {versions[r.name]}" for r in requirements if r not in bad)
    yield Finding("packages", "ok", good or "none")
    for r in bad:
        yield Finding(r.name, "fail", _of(r, versions[r.name]), f"pip install '{r.name}{r.specifier}'")


def of_extra(extra: str, requirements: Sequence[Requirement]) -> Finding:
    """An extra: all of it, or what is missing."""
    versions = {r.name: _installed(r.name) for r in requirements}
    bad = [
        f"{r.name} {_of(r, versions[r.name])}" for r in requirements if not _fits(r, versions[r.name])
    ]
    if bad:
        return Finding(f"extra {extra}", "note", ", ".join(bad), f"pip install '{PACKAGE}[{extra}]'")
    return Finding(f"extra {extra}", "ok", ", ".join(f"{n} {v}" for n, v in versions.items()))


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _fits(requirement: Requirement, found: str | None) -> bool:
    return found is not None and requirement.specifier.contains(found, prereleases=True)


def _of(requirement: Requirement, found: str | None) -> str:
    return "is missing" if found is None else f"is {found}, not {requirement.specifier}"


def processor() -> Iterator[Finding]:
    """The processor, and the threads that evaluators start on it."""
    cores, granted = machine.cores(), machine.quota()
    yield Finding("processor", "ok", f"{machine.processor()}, {os.cpu_count()} cores")
    if granted is not None and granted < cores:
        yield Finding(
            "threads", "note",
            f"{cores} by default, but this container is granted the time of {granted:g} cores",
            f"caterpillar evolve --threads {max(1, math.floor(granted))}",
        )  # fmt: skip
    else:
        yield Finding("threads", "ok", f"{cores} by default")


def drawing() -> Finding:
    """Whether a frame can be drawn off-screen; if not, which backend could."""
    given = os.environ.get("MUJOCO_GL")
    tried = trial("frame")
    if tried.data is not None:
        return Finding("drawing", "ok", "{backend} ({renderer}) drew a frame".format(**tried.data))
    found = f"no frame with MUJOCO_GL {'unset' if given is None else f'= {given}'}: {tried.why}"
    for backend in _BACKENDS:
        if backend != given and trial("frame", MUJOCO_GL=backend).data is not None:
            mend = "unset MUJOCO_GL" if backend is None else f"export MUJOCO_GL={backend}"
            return Finding("drawing", "note", found, mend)
    return Finding("drawing", "note", found, INSTALL_DRAWING)


def ffmpeg() -> Finding:
    """What writes videos."""
    try:
        import imageio_ffmpeg

        return Finding("ffmpeg", "ok", imageio_ffmpeg.get_ffmpeg_version())
    except (ImportError, RuntimeError) as error:
        mend = "pip install imageio-ffmpeg, or apt install ffmpeg"
        return Finding("ffmpeg", "note", f"none: {str(error).splitlines()[0]}", mend)


def simulating(speed: Trial, *, told: bool) -> Iterator[Finding]:
    """Whether robots can be simulated; how fast, if that was measured."""
    if speed.data is None:
        set_but_bad = "MUJOCO_GL" in os.environ and trial("speed", 1, 0.0, MUJOCO_GL=None).data
        again = "pip install --force-reinstall mujoco"
        yield Finding("simulation", "fail", speed.why, "unset MUJOCO_GL" if set_but_bad else again)
        return
    if not told:
        yield Finding("simulation", "ok", "a robot was simulated")
        return
    yield Finding(
        "simulation", "ok",
        "{simulated_s_per_s:,.0f} simulated seconds a second on {threads} threads, "
        "{share_of_limit:.2f} of the bare engine's speed ({robots} robots)".format(**speed.data),
    )  # fmt: skip
    minutes = speed.data["paper_s"] / 60
    yield Finding(
        "the paper's run", "ok",
        f"{speed.data['paper_evaluations']:,} evaluations, at most {minutes:,.0f} min here; robots that "
        "fail early shorten it",
    )  # fmt: skip


class Trial(NamedTuple):
    """What a process of its own came to."""

    data: dict[str, Any] | None
    why: str = ""  #: there is no data


def trial(function: str, *arguments: float, **environment: str | None) -> Trial:
    """Call a function of this module in a process of its own; None unsets a variable."""
    call = f"diagnosis.{function}{arguments}"
    values: Mapping[str, str | None] = {**os.environ, **environment}
    try:
        done = subprocess.run(
            [
                sys.executable, "-P", "-c",
                f"import json; from evolution.cli import diagnosis; print(json.dumps({call}))",
            ],
            env={name: value for name, value in values.items() if value is not None},
            capture_output=True, text=True, timeout=_PATIENCE_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return Trial(None, f"it did not end in {_PATIENCE_S:g} s")
    if done.returncode < 0:
        return Trial(None, f"it crashed ({signal.Signals(-done.returncode).name})")
    if done.returncode:
        return Trial(None, (done.stderr.strip().splitlines() or ["it failed without a word"])[-1])
    return Trial(json.loads(done.stdout.splitlines()[-1]))


def frame() -> dict[str, str]:
    """Draw the robot off-screen: what drew it."""
    import numpy as np

    from caterpillar_env.drawing.backend import choose_backend
    from caterpillar_env.drawing.rendering import RenderingError, RobotRenderer, View
    from caterpillar_env.morphology import Morphology
    from caterpillar_env.physics import Physics

    physics = Physics()
    renderer = RobotRenderer(Morphology(), physics, View(96, 64))
    cold_c = np.full(physics.num_springs, physics.spring.ambient_c)
    picture = renderer.draw(renderer.model.qpos0, cold_c, "rgb_array")
    if picture is None or picture.std() < 1:
        raise RenderingError("the frame is empty")
    from OpenGL import GL

    drawn_by = GL.glGetString(GL.GL_RENDERER)
    renderer.close()
    return {"backend": choose_backend(), "renderer": (drawn_by or b"?").decode()}


def speed(robots: int, limit_s: float) -> dict[str, float]:
    """Simulate robots beside the bare engine, see `benchmarks.engine.measure`."""
    from benchmarks.engine import measure
    from evolution.config import RunConfig

    found, evaluations = measure(robots, limit_s), RunConfig().evaluations()
    return {
        **found._asdict(),
        "simulated_s_per_s": found.simulated_s_per_s,
        "share_of_limit": found.share_of_limit,
        "paper_evaluations": evaluations,
        "paper_s": found.run_s(evaluations),
    }
