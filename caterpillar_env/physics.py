"""What the robot is made of and how it is simulated: all that is not evolved."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal, get_args

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import PhysicsError, TimingError, from_mapping
from caterpillar_env.gait import SPRINGS_PER_GAP, count_steps
from caterpillar_env.sma import SmaSpring

#: Thermal step: the grid on which springs are heated and the fraction handed to the actuators.
SMA_STEP_S = 0.01
#: Control interval: how often failures are judged and, in switch mode, the power may change.
CONTROL_INTERVAL_S = 0.1
GRAVITY_M_S2 = 9.81

Integrator = Literal["discrete", "implicitfast", "rk4"]
Solver = Literal["newton", "cg"]
Cone = Literal["elliptic", "pyramidal"]
BendAxis = Literal["yaw", "pitch"]

_CHOICES = {"integrator": Integrator, "solver": Solver, "cone": Cone, "bend_axis": BendAxis}
_WHOLE = {"num_segments": (2, 64), "mismatch_seed": (0, 2**63), "solver_iterations": (1, 10_000)}
_POSITIVE = (
    "timestep_s", "impratio", "contact_time_constant_s", "stop_time_constant_s", "axial_range"
)  # fmt: skip


@dataclass(frozen=True)
class Physics:
    """Everything about the robot and its simulation that is not evolved. SI units.

    Sources, plausible ranges and what was tried: docs/physics.md and docs/sources.md.

    Raises:
        PhysicsError: a value is of the wrong kind or out of range.
    """

    num_segments: int = 4  #: of the robot, from 2
    spring: SmaSpring = field(default_factory=SmaSpring)
    neck_stiffness_n_m_rad: float = 6e-3  #: silicone neck, Dragon Skin 10
    neck_stiffening: float = 5.0  #: at the joint limit its moment is 1 + this times the linear one
    neck_damping_n_m_s_rad: float = 2e-4  #: silicone, coil friction, anchors: see docs/physics.md
    axial_stiffness_n_m: float = 500.0  #: of the prismatic joint within a segment
    axial_damping_n_s_m: float = 1.0  #: likewise
    axial_range: float = 0.15  #: travel of the prismatic joint as a share of the segment length
    bend_ratio: float = 2.0  #: stiffness and damping of the intra-segment hinge over the neck's
    bend_axis: BendAxis = "yaw"  #: how a segment bends within; the paper does not say
    friction: float = 0.8  #: of feet and elements on the ground
    mismatch_std: float = 0.05  #: spread of the springs' strength from one to another
    mismatch_seed: int = 0  #: which robot of that spread
    spring_strengths: tuple[float, ...] | None = None  #: one a spring, instead of drawn ones
    timestep_s: float = 0.0025  #: of the mechanics: 0.01 over a whole number
    integrator: Integrator = "discrete"  #: MuJoCo's; rk4 needs 0.25 ms
    solver: Solver = "newton"  #: MuJoCo's, of contacts
    cone: Cone = "elliptic"  #: MuJoCo's, of friction
    impratio: float = 100.0  #: MuJoCo's, for grip
    contact_time_constant_s: float = 0.01  #: softness of the ground: see docs/physics.md
    stop_time_constant_s: float = 0.005  #: softness of the joint stops: two timesteps
    solver_tolerance: float = 1e-8  #: MuJoCo's
    solver_iterations: int = 100  #: MuJoCo's, at most

    def __post_init__(self) -> None:
        if isinstance(self.spring, Mapping):
            object.__setattr__(
                self, "spring", from_mapping(SmaSpring, self.spring, "spring", PhysicsError)
            )
        for f in fields(self):
            value = getattr(self, f.name)
            if expected := self._expected(f.name, value):
                raise PhysicsError(f"{f.name} = {value!r} must be {expected}")
            if f.name in _WHOLE:
                object.__setattr__(self, f.name, int(value))
        if self.spring_strengths is not None:
            object.__setattr__(self, "spring_strengths", tuple(map(float, self.spring_strengths)))
        try:
            count_steps(SMA_STEP_S, self.timestep_s, "the thermal step")
        except TimingError:
            raise PhysicsError(
                f"timestep_s = {self.timestep_s:g} must go a whole number of times into the thermal "
                f"step of {SMA_STEP_S:g} s: choose 0.01, 0.005, 0.0025 or 0.001, say"
            ) from None

    def _expected(self, name: str, value: Any) -> str:
        """What a field must be, where it is not."""
        if name == "spring":
            fits, expected = isinstance(value, SmaSpring), "an SmaSpring or a mapping of its fields"
        elif name in _CHOICES:
            known = get_args(_CHOICES[name])
            fits, expected = value in known, f"one of {', '.join(known)}"
        elif name in _WHOLE:
            lower, upper = _WHOLE[name]
            fits = isinstance(value, (int, np.integer)) and lower <= int(value) <= upper
            expected = f"a whole number from {lower} to {upper}"
        elif name == "spring_strengths":
            fits = value is None or (
                isinstance(value, (tuple, list))
                and len(value) == self.num_springs
                and all(isinstance(s, (int, float)) and 0 < s < math.inf for s in value)
            )
            expected = f"{self.num_springs} positive numbers, one a spring"
        else:
            fits = isinstance(value, (int, float)) and 0 <= value < math.inf
            expected = "a finite number, not negative"
            if name in _POSITIVE:
                fits, expected = fits and value > 0, "a finite, positive number"
        return "" if fits else expected

    @property
    def num_springs(self) -> int:
        """Number of SMA springs: four to a gap between neighbouring legged elements."""
        return SPRINGS_PER_GAP * (self.num_segments - 1)

    @classmethod
    def of(cls, value: Physics | Mapping[str, Any] | None) -> Physics:
        """Physics from itself, from a (partial) mapping of its fields, or the default for None.

        Raises:
            PhysicsError: an unknown field or an unusable value.
        """
        return (
            value
            if isinstance(value, Physics)
            else from_mapping(cls, value or {}, "physics", PhysicsError)
        )

    def to_dict(self) -> dict[str, Any]:
        """All fields by name, the spring's nested: plain JSON."""
        return asdict(self)

    def strengths(self) -> Array:
        """Factor on each spring's force, shape (num_springs,): the robot's actuator mismatch.

        `spring_strengths` where given, else normal about 1 with `mismatch_std`, drawn from
        `mismatch_seed`; never below a tenth. Mirrored gaits of a perfect robot would never turn, and the
        paper's yaw criterion would be inert.
        """
        if self.spring_strengths is not None:
            return np.array(self.spring_strengths)
        rng = np.random.default_rng(np.random.SeedSequence(self.mismatch_seed, spawn_key=(0x5A,)))
        return mismatched(self.mismatch_std, rng.standard_normal(self.num_springs))


def mismatched(std: float, normal: Array) -> Array:
    """Strengths about 1 from standard normal draws, never below a tenth."""
    return np.maximum(1.0 + std * normal, 0.1)
