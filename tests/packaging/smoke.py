"""Run by an interpreter that has only the wheel, outside the checkout."""

import importlib.util
import os
import subprocess
import sys
from importlib.metadata import files
from pathlib import Path

import gymnasium

import caterpillar_env

here = Path(__file__).parent
assert "site-packages" in Path(caterpillar_env.__file__).parts, "imported from the checkout"

top_level = {
    path.parts[0] for path in files("caterpillar-sma") or [] if path.suffix in (".py", ".typed")
}
assert top_level == {"caterpillar_env", "evolution", "baselines"}, top_level
assert Path(caterpillar_env.__file__).with_name("py.typed").exists()

for module in ("torch", "ray", "stable_baselines3"):
    assert importlib.util.find_spec(module) is None, f"{module} came with the base install"
import baselines  # noqa: F401, E402
import evolution  # noqa: F401, E402

for name in ("CaterpillarSMA-v0", "CaterpillarSMASwitch-v0"):
    env = gymnasium.make(f"caterpillar_env:{name}")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()

from evolution.study.config import preset  # noqa: E402

assert len(preset("pilot").cells()) > 1, "a preset was not packed"

command = Path(sys.executable).with_name("caterpillar")
run = [command, "evolve", "--preset", "quick", "--shade-population", "4"]
subprocess.run([*run, "--generations", "2", "--out", here / "run"], check=True)
subprocess.run([command, "replay", here / "run", "--no-video"], check=True)
page = (here / "run" / "report.html").read_text("utf-8")
assert "<h1>" in page, "the page was not packed"
doctor = subprocess.run([command, "doctor"], capture_output=True, text=True)
print(doctor.stdout, doctor.stderr)
assert doctor.returncode == 0, "a package is missing"
if "drew a frame" in doctor.stdout or "CI" in os.environ:  # machines of the workflows can draw
    assert (here / "run" / "best.mp4").stat().st_size > 10_000
    assert "<video" in page
print("the wheel works outside the checkout")
