"""Numerical options of MuJoCo: integrator, solver and disabled features."""

from __future__ import annotations

import mujoco

from caterpillar_env.physics import GRAVITY_M_S2, Physics
from caterpillar_env.worlds import Patches, Slope

_INTEGRATORS = {
    "discrete": mujoco.mjtIntegrator.mjINT_DISCRETE,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
}
_SOLVERS = {"newton": mujoco.mjtSolver.mjSOL_NEWTON, "cg": mujoco.mjtSolver.mjSOL_CG}
_CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}


def set_options(spec: mujoco.MjSpec, p: Physics) -> None:
    """Set the numerical options of `spec` from `p`."""
    option = spec.option
    option.timestep = p.timestep_s
    option.integrator = _INTEGRATORS[p.integrator]
    option.solver = _SOLVERS[p.solver]
    option.cone = _CONES[p.cone]
    option.impratio = p.impratio
    option.tolerance = p.solver_tolerance
    option.iterations = p.solver_iterations
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # MuJoCo 4.0.0's sparse Newton Hessian is wrong
    off = mujoco.mjtDisableBit
    # Auto-reset would hide a divergence, which must be reported as a failure.
    option.disableflags |= off.mjDSBL_AUTORESET
    # Islands do not speed up a single robot, and midphase culling does not speed up contacts with a
    # plane. Results are identical without them.
    option.disableflags |= off.mjDSBL_ISLAND
    if p.world.level and not isinstance(p.world, Patches):
        option.disableflags |= off.mjDSBL_MIDPHASE
    if isinstance(p.world, Slope):
        option.gravity = [-GRAVITY_M_S2 * component for component in p.world.up]
