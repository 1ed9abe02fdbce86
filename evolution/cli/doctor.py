"""`caterpillar doctor`."""

from __future__ import annotations

import os
import platform
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from packaging.requirements import Requirement

from caterpillar_env import machine
from caterpillar_env.errors import CaterpillarError
from evolution import cli

PACKAGE = "caterpillar-sma"
TIMEOUT_S = 120.0


class Finding(NamedTuple):
    """The result of one check."""

    name: str
    status: Literal["ok", "--", "NO"]  #: --: something optional does not work
    found: str
    remedy: str = ""


@dataclass(frozen=True)
class DoctorArgs:
    """Check the installed packages, and whether the robot can be drawn.

    The exit status is 1 if a package that every run needs is missing or has an unsupported version.
    Drawing is optional: only videos and rendering need it.
    """


def doctor_command(argv: Sequence[str]) -> int:
    """Check the installed packages, and whether the robot can be drawn."""
    cli.parse(DoctorArgs, argv, "doctor")
    findings = [
        Finding("Python", "ok", f"{platform.python_version()}, {sys.executable}"),
        Finding(PACKAGE, "ok", f"{version(PACKAGE)}, {Path(__file__).resolve().parents[1]}"),
        *check_packages(),
        Finding("cores", "ok", f"{machine.cores()} usable of {os.cpu_count()}"),
        check_drawing(),
    ]
    for finding in findings:
        print(f"{finding.status}  {finding.name:<19}{finding.found}")
        if finding.remedy:
            print(f"{'':23}to fix it: {finding.remedy}")
    ok = all(finding.status != "NO" for finding in findings)
    missing = "A package that every run needs is missing or has an unsupported version."
    print("\n" + ("Everything that a run needs works." if ok else missing))
    return 0 if ok else 1


def check_packages() -> Iterator[Finding]:
    """Check the requirements of this package, and of each extra for users."""
    requirements = [Requirement(text) for text in requires(PACKAGE) or []]
    yield check_requirements("", [r for r in requirements if r.marker is None])
    for extra in metadata(PACKAGE).get_all("Provides-Extra") or []:
        if extra not in ("test", "docs"):
            marked = [r for r in requirements if r.marker and r.marker.evaluate({"extra": extra})]
            yield check_requirements(extra, marked)


def check_requirements(extra: str, requirements: Sequence[Requirement]) -> Finding:
    """Check the requirements of an extra, or those of the package itself if `extra` is empty."""
    found, problems = [], []
    for requirement in requirements:
        try:
            installed = version(requirement.name)
        except PackageNotFoundError:
            problems.append(f"{requirement.name} is missing")
            continue
        found.append(f"{requirement.name} {installed}")
        if not requirement.specifier.contains(installed, prereleases=True):
            problems.append(f"{requirement.name} {installed} does not meet {requirement.specifier}")
    name, target = (f"extra {extra}", f"{PACKAGE}[{extra}]") if extra else ("packages", PACKAGE)
    if problems:
        return Finding(name, "--" if extra else "NO", ", ".join(problems), f"pip install '{target}'")
    return Finding(name, "ok", ", ".join(found))


def draw_frame() -> str:
    """Draw the robot off-screen, and return the backend that drew it."""
    from caterpillar_env import CaterpillarEnv
    from caterpillar_env.drawing.rendering import choose_backend

    env = CaterpillarEnv(render_mode="rgb_array")
    env.reset(seed=0)
    if np.std(env.render()) < 1:
        raise CaterpillarError("the frame is empty")
    return f"{choose_backend()} drew a frame"


def check_drawing() -> Finding:
    """Draw in a separate process, because a bad OpenGL setup can crash the process that uses it."""
    code = "from evolution.cli import doctor; print(doctor.draw_frame())"
    try:
        process = subprocess.run(
            [sys.executable, "-P", "-c", code],
            capture_output=True, text=True, timeout=TIMEOUT_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return Finding("drawing", "--", f"no result after {TIMEOUT_S:g} s")
    if process.returncode == 0:
        return Finding("drawing", "ok", process.stdout.splitlines()[-1])
    problem = (process.stderr.strip() or "failed without a message").splitlines()[-1]
    if process.returncode < 0:
        problem = f"crashed with {signal.Signals(-process.returncode).name}"
    backend = os.environ.get("MUJOCO_GL")
    return Finding("drawing", "--", problem, f"unset MUJOCO_GL (it is {backend!r})" if backend else "")
