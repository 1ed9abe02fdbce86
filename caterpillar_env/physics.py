"""Parameters of the robot's material and of the simulation. Evolution does not change them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, check_fields, from_mapping
from caterpillar_env.gait import SPRINGS_PER_GAP, count_steps
from caterpillar_env.sma import SmaSpring
from caterpillar_env.worlds import Flat, Patches, World

#: Thermal step: interval between updates of the spring temperatures and the actuator controls.
SMA_STEP_S = 0.01
#: Control interval: time between failure checks and, in switch mode, between changes of the power.
CONTROL_INTERVAL_S = 0.1
GRAVITY_M_S2 = 9.81

Integrator = Literal["discrete", "implicitfast", "rk4"]
Solver = Literal["newton", "cg"]
Cone = Literal["elliptic", "pyramidal"]
BendAxis = Literal["yaw", "pitch"]

#: Bounds of the parameters. Material constants can be a hundred times their plausible values.
BOUNDS = {
    "num_segments": (2, 64),
    "neck_stiffness_n_m_rad": (0.0, 1.0),
    "neck_stiffening": (0.0, 1000.0),
    "neck_damping_n_m_s_rad": (0.0, 0.1),
    "axial_stiffness_n_m": (1.0, 100_000.0),  # 0 would let segments collapse
    "axial_damping_n_s_m": (0.0, 200.0),
    "axial_range": (0.001, 1.0),
    "bend_ratio": (0.0, 200.0),
    "friction": (0.0, 100.0),
    "mismatch_std": (0.0, 10.0),
    "mismatch_seed": (0, 2**63),
    "spring_strengths": (1e-9, 1000.0),
    "timestep_s": (1e-6, SMA_STEP_S),
    "impratio": (0.01, 1e5),
    "contact_time_constant_s": (1e-5, 1.0),
    "stop_time_constant_s": (1e-5, 1.0),
    "solver_tolerance": (0.0, 1.0),
    "solver_iterations": (1, 10_000),
}


@dataclass(frozen=True)
class Physics:
    """Parameters of the robot's material and of the simulation, in SI units.

    For sources and plausible ranges, see docs/physics.md and docs/sources.md.

    Raises:
        CaterpillarError: a value has the wrong type or is out of range.
    """

    num_segments: int = 4  #: number of segments, 2 to 64
    spring: SmaSpring = field(default_factory=SmaSpring)
    #: linear stiffness of a neck, the hinge between two segments, N m/rad; silicone (Dragon Skin 10)
    neck_stiffness_n_m_rad: float = 6e-3
    neck_stiffening: float = 5.0  #: cubic moment of a neck at its limit, relative to the linear moment
    neck_damping_n_m_s_rad: float = 2e-4  #: neck damping, N m s/rad, of silicone, coils and anchors
    axial_stiffness_n_m: float = 500.0  #: stiffness of the prismatic joint in a segment, N/m
    axial_damping_n_s_m: float = 1.0  #: damping of the prismatic joint, N s/m
    axial_range: float = 0.15  #: travel of the prismatic joint each way, relative to the segment length
    bend_ratio: float = 2.0  #: stiffness and damping of the intra-segment hinge, relative to a neck
    bend_axis: BendAxis = "yaw"  #: axis of the intra-segment hinge; the paper does not specify it
    friction: float = 0.8  #: friction coefficient of feet and elements on the ground
    mismatch_std: float = 0.05  #: standard deviation of the spring-force factors
    mismatch_seed: int = 0  #: random seed of the spring-force factors
    #: factor on the force of each spring; by default, sampled with mismatch_std and mismatch_seed
    spring_strengths: tuple[float, ...] | None = None
    timestep_s: float = 0.0025  #: physics timestep, s; must divide 0.01
    integrator: Integrator = "discrete"  #: MuJoCo integrator; use rk4 with a timestep of 0.25 ms
    solver: Solver = "newton"  #: MuJoCo constraint solver
    cone: Cone = "elliptic"  #: MuJoCo friction cone
    impratio: float = 100.0  #: MuJoCo impedance ratio; large values reduce slip
    contact_time_constant_s: float = 0.01  #: time constant of ground contacts, s; larger is softer
    stop_time_constant_s: float = 0.005  #: time constant of joint stops, s: two default timesteps
    solver_tolerance: float = 1e-8  #: MuJoCo solver tolerance
    solver_iterations: int = 100  #: maximum number of MuJoCo solver iterations
    world: World = field(default_factory=Flat)  #: ground, such as rough or slope:angle_deg=5

    def __post_init__(self) -> None:
        if not isinstance(self.spring, SmaSpring):
            spring = from_mapping(SmaSpring, self.spring, "spring")
            object.__setattr__(self, "spring", spring)
        object.__setattr__(self, "world", World.of(self.world))
        check_fields(self, BOUNDS)
        if isinstance(self.world, Patches) and self.friction == 0:
            raise CaterpillarError(
                "friction = 0 must be positive in the world patches, because tiles scale the friction"
            )
        strengths = self.spring_strengths
        if strengths is not None and len(strengths) != self.num_springs:
            raise CaterpillarError(
                f"spring_strengths must be {self.num_springs} numbers, one per spring; got "
                f"{len(strengths)} numbers"
            )
        try:
            count_steps(SMA_STEP_S, self.timestep_s, "the thermal step")
        except CaterpillarError:
            raise CaterpillarError(
                f"timestep_s = {self.timestep_s:g} must divide the thermal step of {SMA_STEP_S:g} s; "
                "choose for example 0.01, 0.005, 0.0025 or 0.001"
            ) from None

    @property
    def num_springs(self) -> int:
        """Number of springs: four between each pair of neighbouring legged elements."""
        return SPRINGS_PER_GAP * (self.num_segments - 1)

    @classmethod
    def of(cls, value: Physics | Mapping[str, Any] | None) -> Physics:
        """Return `value` as a `Physics`. Fields that are missing in a mapping keep their defaults.

        Raises:
            CaterpillarError: a field is unknown or its value is invalid.
        """
        if isinstance(value, Physics):
            return value
        return from_mapping(cls, {} if value is None else value, "physics")

    def to_dict(self) -> dict[str, Any]:
        """Return all fields by name, for JSON. `spring` is a nested mapping."""
        return asdict(self)

    def strengths(self) -> Array:
        """Return the factor on the force of each spring (actuator mismatch), shape (num_springs,).

        Without `spring_strengths`, the factors have a normal distribution with mean 1 and standard
        deviation `mismatch_std`. Without mismatch, a robot with a mirrored gait would never turn, and
        the paper's yaw criterion would never apply.
        """
        if self.spring_strengths is not None:
            return np.array(self.spring_strengths)
        rng = np.random.default_rng(np.random.SeedSequence(self.mismatch_seed, spawn_key=(0x5A,)))
        return mismatched(self.mismatch_std, rng.standard_normal(self.num_springs))


def mismatched(std: float, normal: Array) -> Array:
    """Return the strengths max(1 + std * normal, 0.1), where `normal` are standard normal samples."""
    return np.maximum(1.0 + std * normal, 0.1)
