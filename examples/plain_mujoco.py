"""Export a robot as MJCF, and simulate it with plain MuJoCo.

Usage: python examples/plain_mujoco.py ROBOT. ROBOT is a run folder, or the JSON file of a robot.
"""

import itertools
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np

from caterpillar_env import Robot
from caterpillar_env.model import model_xml
from caterpillar_env.sma import SmaState, advance

DURATION_S = 30.0
THERMAL_STEP_S = 0.01

if len(sys.argv) != 2:
    sys.exit(__doc__)
robot = Robot.load(sys.argv[1])

# The model: a file that any MuJoCo program can load, as `caterpillar export ROBOT --to mjcf` writes it.
xml = Path(tempfile.mkdtemp(prefix="caterpillar-")) / "robot.xml"
xml.write_text(model_xml(robot.morphology, robot.physics), encoding="utf-8")
model = mujoco.MjModel.from_xml_path(str(xml))
data = mujoco.MjData(model)

# The gait: the power to each spring in each thermal step, period after period.
period = robot.timings.of_springs(model.nu).power(THERMAL_STEP_S)
steps = round(DURATION_S / THERMAL_STEP_S)
power = np.resize(period, (steps, model.nu))

# The springs: their austenite fraction after each thermal step. It does not depend on the motion.
spring = robot.physics.spring
cold = SmaState.cold(spring, (model.nu,))
path = advance(spring, cold, power, THERMAL_STEP_S).path
fraction = np.vstack([cold.fraction, path.fraction])

# The mechanics. The control is the mean fraction during a physics step, interpolated linearly.
substeps = round(THERMAL_STEP_S / model.opt.timestep)
mujoco.mj_forward(model, data)
start_m = data.subtree_com[1, 0]  # x of the centre of mass of the robot; body 1 is its root
for before, after in itertools.pairwise(fraction):
    for substep in range(substeps):
        data.ctrl = before + (after - before) * (substep + 0.5) / substeps
        mujoco.mj_step(model, data)

# mj_step computes the centre of mass at the start of the step. Recorded distances also refer to it.
# Evolution stops a robot that fails; this loop does not.
distance_m = data.subtree_com[1, 0] - start_m
print(f"{data.time:.0f} s  {1000 * distance_m:.3f} mm; recorded {1000 * (robot.fitness_m or 0):.3f} mm")
print(f"view it: python -m mujoco.viewer --mjcf={xml}")
