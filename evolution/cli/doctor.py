"""`caterpillar doctor`.

MuJoCo runs in separate processes only, because a bad OpenGL setup can crash a process that uses it.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from pathlib import Path
from typing import Literal, NamedTuple

from packaging.requirements import Requirement

from caterpillar_env import machine
from caterpillar_env.errors import CaterpillarError
from evolution import cli

PACKAGE = "caterpillar-sma"
TIMEOUT_S = 120.0
Status = Literal["ok", "note", "fail"]  #: note: something optional does not work
_MARKS = {"ok": "ok", "note": "--", "fail": "NO"}


class Finding(NamedTuple):
    """The result of one check."""

    name: str
    status: Status
    found: str
    remedy: str = ""


@dataclass(frozen=True)
class DoctorArgs:
    """Check the installed packages, drawing, and the simulation speed of this machine.

    The exit status is 1 if something that every run needs does not work. Drawing is optional: only
    videos and rendering need it.
    """

    json: bool = False
    """Print JSON instead of a table."""


def doctor_command(argv: Sequence[str]) -> int:
    """Check the installation, drawing and the simulation speed."""
    args = cli.parse(DoctorArgs, argv, "doctor")
    findings = [
        Finding("Python", "ok", f"{platform.python_version()}, {sys.executable}"),
        Finding(PACKAGE, "ok", f"{version(PACKAGE)}, {Path(__file__).resolve().parents[1]}"),
        *check_packages(),
        Finding("cores", "ok", f"{machine.cores()} usable of {os.cpu_count()}"),
        check_isolated("drawing", "draw_frame", "note"),
        check_isolated("ffmpeg", "find_ffmpeg", "note"),
        check_isolated("simulation", "measure_speed", "fail"),
    ]
    ok = all(finding.status != "fail" for finding in findings)
    if args.json:
        print(json.dumps({"ok": ok, "findings": [f._asdict() for f in findings]}, indent=2))
    else:
        for finding in findings:
            print(f"{_MARKS[finding.status]}  {finding.name:<19}{finding.found}")
            if finding.remedy:
                print(f"{'':23}to fix it: {finding.remedy}")
        print(f"\n{'Everything' if ok else 'Not everything'} that a run needs works.")
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
            problems.append(f"{requirement.name} {installed} is not {requirement.specifier}")
    name, target = (f"extra {extra}", f"{PACKAGE}[{extra}]") if extra else ("packages", PACKAGE)
    if problems:
        status: Status = "note" if extra else "fail"
        return Finding(name, status, ", ".join(problems), f"pip install '{target}'")
    return Finding(name, "ok", ", ".join(found))


def check_isolated(name: str, function: str, otherwise: Status) -> Finding:
    """Call a function of this module in a separate process, and report its result or its failure."""
    code = f"from evolution.cli import doctor; print(doctor.{function}())"
    try:
        process = subprocess.run(
            [sys.executable, "-P", "-c", code],
            capture_output=True, text=True, timeout=TIMEOUT_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return Finding(name, otherwise, f"no result after {TIMEOUT_S:g} s")
    if process.returncode == 0:
        return Finding(name, "ok", process.stdout.splitlines()[-1])
    problem = (process.stderr.strip() or "failed without a message").splitlines()[-1]
    if process.returncode < 0:
        problem = f"crashed with {signal.Signals(-process.returncode).name}"
    backend = os.environ.get("MUJOCO_GL")
    return Finding(name, otherwise, problem, f"unset MUJOCO_GL (it is {backend!r})" if backend else "")


def draw_frame() -> str:
    """Draw the robot off-screen, and return the backend that drew it."""
    from caterpillar_env import CaterpillarEnv
    from caterpillar_env.drawing.backend import choose_backend

    env = CaterpillarEnv(render_mode="rgb_array")
    env.reset(seed=0)
    frame = env.render()
    env.close()
    if frame is None or frame.std() < 1:
        raise CaterpillarError("the frame is empty")
    return f"{choose_backend()} drew a frame"


def find_ffmpeg() -> str:
    """Return the version of the program that encodes videos."""
    import imageio_ffmpeg

    return str(imageio_ffmpeg.get_ffmpeg_version())


def measure_speed() -> str:
    """Measure the speed with 50 robots of the paper's first generation, for 10 s each."""
    from caterpillar_env.robot import simulate
    from caterpillar_env.task import EPISODE_S
    from evolution.config import RunConfig

    config = RunConfig()
    bodies, timings = config.encoding.decode(config.make_optimizer().ask()[:50])
    started = time.perf_counter()
    simulated_s = float(simulate(bodies, timings, config.physics, duration_s=10.0).simulated_s.sum())
    rate = simulated_s / (time.perf_counter() - started)
    minutes = config.evaluations() * EPISODE_S / rate / 60
    return (
        f"{rate:,.0f} simulated seconds per second; the paper's run of {config.evaluations():,} "
        f"evaluations takes at most {minutes:,.0f} min"
    )
