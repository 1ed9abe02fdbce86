"""Export a robot, and let it crawl in a MuJoCo loop without the simulation of this package.

Usage: python examples/plain_mujoco.py ROBOT. ROBOT is a run folder or the JSON file of an evolved robot.
"""

import itertools
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np

from caterpillar_env.robot import Robot
from caterpillar_env.sma import SmaState, advance
from evolution.cli import main as caterpillar

DURATION_S = 30.0
THERMAL_STEP_S = 0.01

# The model: an XML that any MuJoCo program can load.
if len(sys.argv) != 2:
    sys.exit(__doc__)
source = Path(sys.argv[1])
xml = Path(tempfile.mkdtemp(prefix="caterpillar-")) / "robot.xml"
if status := caterpillar(["export", str(source), "--to", "mjcf", "--out", str(xml)]):
    sys.exit(status)
model = mujoco.MjModel.from_xml_path(str(xml))
data = mujoco.MjData(model)

# The gait: the power to each spring in each thermal step, period after period.
robot = Robot.load(source)
period = robot.timings.of_springs(model.nu).power(THERMAL_STEP_S)
steps = round(DURATION_S / THERMAL_STEP_S)
power = np.resize(period, (steps, model.nu))

# The springs: their austenite fraction after each thermal step; it does not depend on the motion.
spring = robot.physics.spring
cold = SmaState.cold(spring, (model.nu,))
fraction = np.vstack([cold.fraction, advance(spring, cold, power, THERMAL_STEP_S).fraction])

# The mechanics. Control is the mean fraction during a physics step, linear between thermal steps.
substeps = round(THERMAL_STEP_S / model.opt.timestep)
mujoco.mj_forward(model, data)
start_m = data.subtree_com[1, 0]  # x of the centre of mass of all that hangs on body 1, the head
for before, after in itertools.pairwise(fraction):
    for substep in range(substeps):
        data.ctrl = before + (after - before) * (substep + 0.5) / substeps
        mujoco.mj_step(model, data)

# mj_step derives the centre of mass at its start, one step before the end. So does what was recorded,
# except for a robot that failed: evolution stops it, and this loop goes on.
distance_m = data.subtree_com[1, 0] - start_m
print(f"{data.time:.0f} s  {1000 * distance_m:.3f} mm; recorded {1000 * (robot.fitness_m or 0):.3f} mm")
print(f"look at it: python -m mujoco.viewer --mjcf={xml}")
