"""Shape-memory-alloy springs: thermal balance, phase hysteresis and the two-state spring.

Per metre of wire of mass m' = rho pi d^2 / 4, with T the temperature and xi the austenite fraction,

    m' dH/dt = I^2 R' u - h s pi d (T - T_ambient),     H = c T + L xi            (energy balance)
    xi <- clip(xi, heating_branch(T), cooling_branch(T))                          (play operator)

u in [0, 1] is the share of the time that the power is on. The state kept is the specific enthalpy H
(J/kg, from 0 degC martensite) and xi, because the play operator has the same form in H: at a given H
both branches are single-valued, so a step needs no iteration and no heat is lost or made at the
transformation. The temperature follows from H and xi. It depends on the power history alone, never on
the motion: no influence of stress (Clausius-Clapeyron) is modelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import PhysicsError


@dataclass(frozen=True)
class SmaSpring:
    """Wire, coil and drive of one spring. Sources and confidence: docs/sources.md.

    Raises:
        PhysicsError: the transformation temperatures do not allow a hysteresis loop, or a quantity that
            must be positive is not.
    """

    wire_diameter_m: float = 0.15e-3  #: BMX150-like micro coil
    coil_diameter_m: float = 0.47e-3  #: mean diameter of the coil
    turns: float = 100.0  #: of the coil
    density_kg_m3: float = 6450.0  #: Dynalloy F1140 sheet
    specific_heat_j_kg_k: float = 500.0  #: fitted to the heating column of the sheet; 450-837 plausible
    latent_heat_j_kg: float = 24_200.0  #: Dynalloy F1140 sheet
    resistivity_ohm_m: float = 0.98e-6  #: 55 ohm/m at 0.15 mm, Dynalloy F1140 sheet
    convection_w_m2_k: float = 110.0  #: Churchill-Chu cylinder and radiation at 0.15 mm
    coil_shielding: float = 0.7  #: share of a straight wire's convection; judgement, 0.5-1
    austenite_start_c: float = 68.0  #: As, under load
    austenite_finish_c: float = 78.0  #: Af
    martensite_start_c: float = 66.0  #: Ms, judgement: see docs/sources.md
    martensite_finish_c: float = 56.0  #: Mf, likewise
    ambient_c: float = 25.0  #: of the air
    austenite_stiffness_n_m: float = 35.0  #: secant: 0.70 N at 36 mm
    martensite_stiffness_n_m: float = 14.5  #: austenite's, times the ratio of Young's moduli
    austenite_rest_length_m: float = 0.016  #: solid length: turns x wire diameter, rounded up
    martensite_rest_length_m: float = 0.0222  #: 0.20 N at 36 mm, the detwinning plateau
    force_limit_n: float = 0.85  #: 300 MPa of shear in the wire
    drive_current_a: float = 0.35  #: while the power is on; 90 % hot within about 1 s
    cut_off_c: float = 120.0  #: over-temperature cut-off of the driver

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not number or not math.isfinite(value):
                raise PhysicsError(f"{name} = {value!r} must be a finite number")
            if value <= 0 and name not in ("latent_heat_j_kg", "ambient_c", "drive_current_a"):
                raise PhysicsError(f"{name} = {value:g} must be positive")
        if self.latent_heat_j_kg < 0 or self.drive_current_a < 0:
            raise PhysicsError(
                "latent_heat_j_kg and drive_current_a must not be negative; got "
                f"{self.latent_heat_j_kg:g} and {self.drive_current_a:g}"
            )
        ordered = (
            self.ambient_c < self.martensite_finish_c < self.martensite_start_c
            and self.martensite_finish_c < self.austenite_start_c < self.austenite_finish_c
            and self.martensite_start_c < self.austenite_finish_c < self.cut_off_c
        )
        if not ordered:
            raise PhysicsError(
                "transformation temperatures must satisfy ambient < Mf < Ms < Af < cut-off and "
                f"Mf < As < Af; got ambient {self.ambient_c:g}, Mf {self.martensite_finish_c:g}, "
                f"Ms {self.martensite_start_c:g}, As {self.austenite_start_c:g}, "
                f"Af {self.austenite_finish_c:g}, cut-off {self.cut_off_c:g} degC"
            )

    @property
    def wire_length_m(self) -> float:
        """Length of wire in the coil (small helix angle): n pi D."""
        return self.turns * math.pi * self.coil_diameter_m

    @property
    def mass_per_m_kg(self) -> float:
        """m', mass of a metre of wire."""
        return self.density_kg_m3 * math.pi * self.wire_diameter_m**2 / 4

    @property
    def resistance_per_m_ohm(self) -> float:
        """R', resistance of a metre of wire."""
        return self.resistivity_ohm_m / (math.pi * self.wire_diameter_m**2 / 4)

    @property
    def drive_power_w(self) -> float:
        """Electrical power of the whole spring while it is driven: I^2 R."""
        return self.drive_current_a**2 * self.resistance_per_m_ohm * self.wire_length_m

    @property
    def heating_w_kg(self) -> float:
        """Specific heating power while driven: I^2 R' / m'."""
        return self.drive_current_a**2 * self.resistance_per_m_ohm / self.mass_per_m_kg

    @property
    def cooling_w_kg_k(self) -> float:
        """Specific convective loss per kelvin above ambient: h s pi d / m'."""
        loss = self.convection_w_m2_k * self.coil_shielding * math.pi * self.wire_diameter_m
        return loss / self.mass_per_m_kg

    @property
    def time_constant_s(self) -> float:
        """Thermal time constant without transformation: rho c d / (4 h s)."""
        return self.specific_heat_j_kg_k / self.cooling_w_kg_k

    @cached_property
    def branches(self) -> Branches:
        """Both branches of the hysteresis over enthalpy."""
        return Branches.of(self)


def heating_branch(spring: SmaSpring, temperature_c: Array) -> Array:
    """Austenite fraction on heating, a half cosine from 0 at As to 1 at Af (Liang and Rogers 1990)."""
    share = (temperature_c - spring.austenite_start_c) / (
        spring.austenite_finish_c - spring.austenite_start_c
    )
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0))


def cooling_branch(spring: SmaSpring, temperature_c: Array) -> Array:
    """Austenite fraction on cooling, a half cosine from 1 at Ms to 0 at Mf (Liang and Rogers 1990)."""
    share = (temperature_c - spring.martensite_finish_c) / (
        spring.martensite_start_c - spring.martensite_finish_c
    )
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0))


class Branches(NamedTuple):
    """The two branches tabulated over enthalpy, linear in between; outside they are 0 and 1."""

    enthalpy: Array
    fraction: NDArray[np.complex128]  #: heating branch the real part, cooling the imaginary one

    @classmethod
    def of(cls, spring: SmaSpring, nodes: int = 1025) -> Branches:
        """Tabulate `spring`'s branches at `nodes` temperatures each."""
        heat_c = np.linspace(spring.austenite_start_c, spring.austenite_finish_c, nodes)
        cool_c = np.linspace(spring.martensite_finish_c, spring.martensite_start_c, nodes)
        heat_xi, cool_xi = heating_branch(spring, heat_c), cooling_branch(spring, cool_c)
        c, latent = spring.specific_heat_j_kg_k, spring.latent_heat_j_kg
        heat_h, cool_h = c * heat_c + latent * heat_xi, c * cool_c + latent * cool_xi
        both = np.union1d(heat_h, cool_h)
        fraction = np.interp(both, heat_h, heat_xi) + 1j * np.interp(both, cool_h, cool_xi)
        return cls(both, fraction)


class SmaState(NamedTuple):
    """State of any number of springs of one kind."""

    enthalpy_j_kg: Array  #: H = c T + L xi, shape (..., springs)
    fraction: Array  #: xi, austenite fraction in [0, 1], same shape

    @classmethod
    def cold(
        cls, spring: SmaSpring, shape: tuple[int, ...], ambient_c: Array | float | None = None
    ) -> SmaState:
        """Springs at ambient temperature, the spring's own or another (broadcast), all martensite."""
        warm = spring.specific_heat_j_kg_k * (spring.ambient_c if ambient_c is None else ambient_c)
        return cls(np.full(shape, warm), np.zeros(shape))

    @classmethod
    def at(cls, spring: SmaSpring, temperature_c: Array, fraction: Array) -> SmaState:
        """Springs at a temperature (degC) with a fraction, which the branches clip."""
        xi = np.clip(
            fraction, heating_branch(spring, temperature_c), cooling_branch(spring, temperature_c)
        )
        return cls(spring.specific_heat_j_kg_k * temperature_c + spring.latent_heat_j_kg * xi, xi)

    def temperature_c(self, spring: SmaSpring) -> Array:
        """T = (H - L xi) / c, degC, of the state's shape."""
        return (
            self.enthalpy_j_kg - spring.latent_heat_j_kg * self.fraction
        ) / spring.specific_heat_j_kg_k


class SmaStep(NamedTuple):
    """What `advance` did with springs of shape S over K steps."""

    state: SmaState  #: after the last step
    fraction: Array  #: xi after each step, shape (K,) + S
    enthalpy_j_kg: Array  #: H after each step, likewise
    power: Array  #: share of the drive power really drawn in each step, shape (K,) + S


def advance(
    spring: SmaSpring,
    state: SmaState,
    power: Array,
    step_s: float,
    ambient_c: Array | float | None = None,
) -> SmaStep:
    """Integrate the springs over K steps of `step_s` seconds.

    Exponential Euler in H: exact while xi is frozen and the power constant; while transforming the
    relative error of the rate is at most step_s / (2 tau), 0.3 % at 10 ms. The cut-off is an ideal
    thermostat: the driver draws just the power that holds `cut_off_c`.

    Args:
        spring: what the springs are made of.
        state: before the first step, arrays of shape S.
        power: commanded share of the drive power in each step, in [0, 1], shape (K,) + S.
        step_s: length of a step, s.
        ambient_c: temperature of the air where it is not the spring's own, degC, broadcast to S.

    Returns:
        The state after the steps, with the fraction and the drawn power after each.
    """
    c, latent = spring.specific_heat_j_kg_k, spring.latent_heat_j_kg
    tau = spring.time_constant_s
    span_s = -tau * math.expm1(-step_s / tau)  # the step's length seen through exponential decay
    gain = spring.heating_w_kg * span_s
    decay = spring.cooling_w_kg_k * span_s / c  # of H over ambient, at frozen xi
    inflow = decay * c * (spring.ambient_c if ambient_c is None else ambient_c)
    cut_off = c * spring.cut_off_c + latent  # it lies above Af, where xi is 1
    hot = np.maximum(state.enthalpy_j_kg, cut_off)
    # A spring that is hotter to begin with is not powered.
    supply = np.multiply(power, gain * (hot <= cut_off), order="C") + inflow

    # Written for few springs, where the number of calls counts: H and xi are one array.
    weight = np.empty((2, *hot.shape))
    weight[0], weight[1] = 1.0 - decay, decay * latent
    path = np.empty((len(power) + 1, *weight.shape))
    path[0] = state
    parts = np.empty_like(weight)
    kept, released = parts
    nodes, branches = spring.branches
    steps = zip(path[:-1], path[:-1, 1], supply, path[1:, 0], path[1:, 1], strict=True)
    for now, xi, supplied, enthalpy, fraction in steps:
        np.multiply(now, weight, out=parts)
        np.add(kept, released, out=kept)
        np.add(kept, supplied, out=kept)
        np.minimum(kept, hot, out=enthalpy)
        limits = np.interp(enthalpy, nodes, branches)
        np.maximum(xi, limits.real, out=kept)
        np.minimum(kept, limits.imag, out=fraction)
    flows = path[:-1] * weight
    unpowered = flows[:, 0] + flows[:, 1] + inflow
    drawn = (path[1:, 0] - unpowered) * (1.0 / gain if gain > 0 else 0.0)
    return SmaStep(SmaState(*path[-1]), path[1:, 1], path[1:, 0], drawn)


def spring_force(spring: SmaSpring, length_m: Array, fraction: Array) -> Array:
    """Pulling force of a two-state spring, N: (1 - xi) k_M (l - l_M) + xi k_A (l - l_A), clipped to
    [0, force_limit_n]. The model's actuators compute the same (see `caterpillar_env.model`).
    """
    cold = spring.martensite_stiffness_n_m * (length_m - spring.martensite_rest_length_m)
    hot = spring.austenite_stiffness_n_m * (length_m - spring.austenite_rest_length_m)
    return np.clip((1 - fraction) * cold + fraction * hot, 0.0, spring.force_limit_n)
