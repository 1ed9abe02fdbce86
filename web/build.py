"""Build the page in `web/dist`: `python web/build.py`. It needs Node with npm.

The page simulates the robot in the browser. This script exports the data that the page shares with the
Python package to `web/src/data.json`: the model, all numbers, and the winners of the published study.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import asdict
from importlib.metadata import files
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from caterpillar_env.drawing.overlay import spring_rgb
from caterpillar_env.gait import GAIT_PERIOD_S, MAX_DUTY, pair_names
from caterpillar_env.ground import LOADS
from caterpillar_env.model import ModelBuilder, model_xml
from caterpillar_env.morphology import PARAMETERS, Morphology
from caterpillar_env.physics import CONTROL_INTERVAL_S, SMA_STEP_S, Physics
from caterpillar_env.robot import Robot
from caterpillar_env.sma import NODES
from caterpillar_env.task import EPISODE_S, MIN_LOAD_N, FailureLimits
from evolution.genome import Encoding
from evolution.study.config import load

WEB = Path(__file__).parent
WINNERS = WEB.parent / "results" / "search" / "winners"
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])")
_NODE = "20.19 or later 20, or 22.12 or later"  # as Vite 8 requires
_PROBES = 60
_DIGITS = 11  #: decimal places of coefficients


def export_data() -> dict[str, Any]:
    """Return the content of `data.json`."""
    physics = Physics()
    spring = physics.spring
    model = ModelBuilder(physics, scenery=False).build(Morphology())
    derived = ("heating_w_kg", "cooling_w_kg_k", "time_constant_s", "drive_power_w")
    ramp_c = np.linspace(spring.ambient_c, spring.cut_off_c, 33)
    study = load(WINNERS.parent)
    wave = Encoding(physics, timing="wave").genes[len(PARAMETERS) :]
    return {
        "mujoco": mujoco.__version__,
        "parameters": [
            p._asdict() | dict(zip(("factor", "shown"), gene.shown, strict=True))
            for p, gene in zip(PARAMETERS, Encoding(physics).genes, strict=False)
        ],
        "pairs": pair_names(physics.num_segments),
        "wave": [gene.name for gene in wave],
        "circular": [gene.circular for gene in wave],
        "gait_period_s": GAIT_PERIOD_S,
        "max_duty": MAX_DUTY,
        "timestep_s": physics.timestep_s,
        "sma_step_s": SMA_STEP_S,
        "control_interval_s": CONTROL_INTERVAL_S,
        "episode_s": EPISODE_S,
        "min_load_n": MIN_LOAD_N,
        "thresholds": FailureLimits()._asdict(),
        "loads": list(range(model.nsensordata))[LOADS],
        "spring": asdict(spring) | {name: getattr(spring, name) for name in derived} | {"nodes": NODES},
        "colours": spring_rgb(spring, ramp_c).round(4).tolist(),
        "model": _parametrize(physics),
        # `trim_tendons` changes these arrays, but XML cannot store them
        "tendons": {name: getattr(model, name).tolist() for name in ("ten_J_rownnz", "ten_J_colind")},
        "search": {
            "population": study.arms["shade"].config.shade.shade_population,
            "budget_s": study.budget_s,
        },
        "winners": [_read_winner(path, physics) for path in sorted(WINNERS.glob("*/*.json"))],
    }


def _parametrize(physics: Physics) -> dict[str, Any]:
    """Return the XML of robots as pieces of text, and the numbers between them.

    Every number is a linear combination of 1, the body's parameters, and 1 / q^2, where q is
    `joint_limit_rad`. The coefficients are fitted to the XML of random bodies with taut springs, and
    must reproduce every number in it.
    """
    rng = np.random.default_rng(0)
    bodies = [Morphology.from_unit(unit) for unit in 0.1 + 0.9 * rng.random((_PROBES, len(PARAMETERS)))]
    texts = [model_xml(body, physics, scenery=False) for body in bodies]
    pieces = _NUMBER.split(texts[0])
    if any(_NUMBER.split(text) != pieces for text in texts):
        raise SystemExit("the XML of two bodies differs in more than numbers; change web/build.py")
    values = np.array([[float(number) for number in _NUMBER.findall(text)] for text in texts])
    terms = np.array([[1.0, *body.to_array(), body.joint_limit_rad**-2] for body in bodies])
    varies = np.ptp(values, axis=0) > 0
    fitted = (
        np.linalg.lstsq(terms, values[:, varies])[0].round(_DIGITS) + 0.0
    )  # no rounding errors, no -0
    error = np.abs(terms @ fitted - values[:, varies]).max()
    if error > 1e-14:
        raise SystemExit(f"the model depends on the body in a new way (error {error:g}); add a term")
    coefficients, slots = np.unique(fitted.T, axis=0, return_inverse=True)
    joined = [pieces[0]]
    for number, vary, piece in zip(_NUMBER.findall(texts[0]), varies, pieces[1:], strict=True):
        if vary:
            joined.append(piece)
        else:
            joined[-1] += number + piece
    return {"pieces": joined, "slots": slots.tolist(), "coefficients": coefficients.tolist()}


def _read_winner(path: Path, physics: Physics) -> dict[str, Any]:
    robot = Robot.load(path)
    if robot.physics != physics or not isinstance(robot.morphology, Morphology) or robot.kind != "pairs":
        raise SystemExit(
            f"{path}: the page takes only robots with the default physics, one body for all segments "
            "and a left-right symmetric gait"
        )
    return {
        "name": f"{path.parent.name}, seed {path.stem.removeprefix('seed-')}",
        "distance_m": robot.fitness_m,
        "body": robot.morphology.to_array().tolist(),
        "on_s": robot.timings.on_s.tolist(),
        "off_s": robot.timings.off_s.tolist(),
    }


def find_npm() -> str | None:
    """Return the path of npm, or None if Node is missing or has an unsupported version."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        return None
    answer = subprocess.run([node, "--version"], check=True, capture_output=True, text=True).stdout
    version = tuple(int(part) for part in re.findall(r"\d+", answer)[:2])
    return npm if (20, 19) <= version < (21,) or version >= (22, 12) else None


def build_page() -> Path:
    """Export the data, install the packages of the lock file, build the page and return its folder.

    Raises:
        SystemExit: Node is missing or has an unsupported version, or npm failed.
    """
    npm = find_npm()
    if npm is None:
        raise SystemExit(f"building the page needs Node {_NODE}, with npm; no such version was found")
    (WEB / "src" / "data.json").write_text(json.dumps(export_data()), encoding="utf-8")
    installed, lock = WEB / "node_modules" / ".package-lock.json", WEB / "package-lock.json"
    if not installed.exists() or installed.stat().st_mtime < lock.stat().st_mtime:
        _run(npm, "ci", "--no-audit", "--no-fund")
    _run(npm, "run", "--silent", "build")
    licences = WEB / "dist" / "licences.md"  # of the packages that Vite has bundled
    (notice,) = [f for f in files("mujoco") or () if f.parts[-2:] == ("licenses", "LICENSE")]
    mujoco_text = Path(str(notice.locate())).read_text("utf-8")
    text = licences.read_text("utf-8")
    licences.write_text(f"{text.rstrip()}\n\n## @mujoco/mujoco\n\n{mujoco_text}", encoding="utf-8")
    return WEB / "dist"


def _run(*command: str) -> None:
    if subprocess.run(command, cwd=WEB, check=False).returncode:
        raise SystemExit(f"{' '.join(command)} failed in {WEB}; see its message above")


if __name__ == "__main__":
    print(build_page())
