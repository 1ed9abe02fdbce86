"""Shape-memory-alloy springs: thermal balance, phase hysteresis and the two-state spring.

The equations for one metre of wire with mass m' = rho pi d^2 / 4, temperature T and austenite fraction
xi are

    m' dH/dt = I^2 R' u - h s pi d (T - T_ambient),     H = c T + L xi            (energy balance)
    xi <- clip(xi, heating_branch(T), cooling_branch(T))                          (play operator)

where u in [0, 1] is the share of the full drive power. The state consists of the specific enthalpy H
(J/kg, zero for martensite at 0 degC) and xi, which together determine the temperature. Both branches
are single-valued functions of H. A step therefore needs no iteration and conserves energy during the
transformation. Stress does not shift the transformation temperatures (no Clausius-Clapeyron effect),
so the thermal state depends only on the power history, not on the motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from caterpillar_env.arrays import Array, compiled
from caterpillar_env.errors import CaterpillarError, check_fields

#: Number of temperatures at which each branch is tabulated.
NODES = 1025
_PERIODS = (11, 1000)  #: smallest and largest number of periods that `settle` simulates
_TIME_CONSTANTS = 20  #: duration until the temperatures are periodic, in time constants
_TEMPERATURES = (-273.15, 2000.0)
#: Bounds of the parameters. Most are at least a factor of 100 beyond plausible values. Outside the
#: bounds, the simulation could overflow.
BOUNDS = {
    "wire_diameter_m": (1e-6, 0.02),
    "coil_diameter_m": (4e-6, 0.05),
    "turns": (1.0, 10_000.0),
    "density_kg_m3": (50.0, 700_000.0),
    "specific_heat_j_kg_k": (5.0, 50_000.0),
    "latent_heat_j_kg": (0.0, 3e6),
    "resistivity_ohm_m": (5e-9, 1e-4),
    "convection_w_m2_k": (1e-9, 20_000.0),  # nearly 0 makes the spring adiabatic
    "coil_shielding": (0.005, 10.0),
    "austenite_start_c": _TEMPERATURES,
    "austenite_finish_c": _TEMPERATURES,
    "martensite_start_c": _TEMPERATURES,
    "martensite_finish_c": _TEMPERATURES,
    "ambient_c": _TEMPERATURES,
    "austenite_stiffness_n_m": (0.1, 5000.0),
    "martensite_stiffness_n_m": (0.1, 5000.0),
    "austenite_rest_length_m": (1e-4, 3.0),
    "martensite_rest_length_m": (1e-4, 3.0),
    "force_limit_n": (0.005, 100.0),
    "drive_current_a": (0.0, 50.0),
    "cut_off_c": _TEMPERATURES,
}


@dataclass(frozen=True)
class SmaSpring:
    """Wire, coil and drive of one spring. For the sources of the values, see docs/sources.md.

    Raises:
        CaterpillarError: a value is not a finite number or is out of bounds, or the transformation
            temperatures form no hysteresis loop.
    """

    wire_diameter_m: float = 0.15e-3  #: wire diameter, m, as in the BMX150 micro coil
    coil_diameter_m: float = 0.47e-3  #: mean diameter of the coil, m
    turns: float = 100.0  #: number of turns of the coil
    density_kg_m3: float = 6450.0  #: density of the wire, kg/m3 (Dynalloy F1140 sheet)
    #: specific heat, J/(kg K), fitted to the heating times of the data sheet; plausible 450-837
    specific_heat_j_kg_k: float = 500.0
    latent_heat_j_kg: float = 24_200.0  #: heat of transformation, J/kg (Dynalloy F1140 sheet)
    resistivity_ohm_m: float = 0.98e-6  #: resistivity, ohm m; 55 ohm/m at 0.15 mm (Dynalloy F1140 sheet)
    #: heat transfer coefficient, W/(m2 K): free convection (Churchill-Chu) and radiation
    convection_w_m2_k: float = 110.0
    coil_shielding: float = 0.7  #: convection relative to a straight wire; estimate; plausible 0.3-1
    austenite_start_c: float = 68.0  #: austenite start temperature As, degC, under load
    austenite_finish_c: float = 78.0  #: austenite finish temperature Af, degC
    martensite_start_c: float = 66.0  #: martensite start temperature Ms, degC; estimate
    martensite_finish_c: float = 56.0  #: martensite finish temperature Mf, degC; estimate
    ambient_c: float = 25.0  #: air temperature, degC
    austenite_stiffness_n_m: float = 35.0  #: secant stiffness when hot, N/m: 0.70 N at 36 mm
    martensite_stiffness_n_m: float = 14.5  #: stiffness when cold, N/m; from the ratio of Young's moduli
    austenite_rest_length_m: float = 0.016  #: hot rest length, m: just above the solid length, 15 mm
    martensite_rest_length_m: float = 0.0222  #: cold rest length, m: 0.20 N at 36 mm, detwinning plateau
    force_limit_n: float = 0.85  #: largest force, N: 300 MPa of shear stress in the wire
    drive_current_a: float = 0.35  #: drive current while on, A; reaches 90 % austenite in about 1 s
    cut_off_c: float = 120.0  #: over-temperature limit of the driver, degC

    def __post_init__(self) -> None:
        check_fields(self, BOUNDS)
        is_loop = (
            self.ambient_c < self.martensite_finish_c < self.martensite_start_c
            and self.martensite_finish_c < self.austenite_start_c < self.austenite_finish_c
            and self.martensite_start_c < self.austenite_finish_c < self.cut_off_c
        )
        if not is_loop:
            raise CaterpillarError(
                "transformation temperatures must satisfy ambient < Mf < Ms < Af < cut-off and "
                f"Mf < As < Af; got ambient {self.ambient_c:g}, Mf {self.martensite_finish_c:g}, "
                f"Ms {self.martensite_start_c:g}, As {self.austenite_start_c:g}, "
                f"Af {self.austenite_finish_c:g}, cut-off {self.cut_off_c:g} degC"
            )

    @cached_property
    def mass_per_m_kg(self) -> float:
        """Mass per metre of wire, m'."""
        return self.density_kg_m3 * math.pi * self.wire_diameter_m**2 / 4

    @cached_property
    def resistance_per_m_ohm(self) -> float:
        """Resistance per metre of wire, R'."""
        return self.resistivity_ohm_m / (math.pi * self.wire_diameter_m**2 / 4)

    @cached_property
    def drive_power_w(self) -> float:
        """Electrical power of the spring while on, I^2 R' n pi D (for a small helix angle)."""
        wire_length_m = self.turns * math.pi * self.coil_diameter_m
        return self.drive_current_a**2 * self.resistance_per_m_ohm * wire_length_m

    @cached_property
    def heating_w_kg(self) -> float:
        """Heating power per kilogram while on, I^2 R' / m'."""
        return self.drive_current_a**2 * self.resistance_per_m_ohm / self.mass_per_m_kg

    @cached_property
    def cooling_w_kg_k(self) -> float:
        """Heat loss per kilogram and kelvin above ambient, h s pi d / m'."""
        loss = self.convection_w_m2_k * self.coil_shielding * math.pi * self.wire_diameter_m
        return loss / self.mass_per_m_kg

    @cached_property
    def time_constant_s(self) -> float:
        """Thermal time constant outside the transformation, rho c d / (4 h s)."""
        return self.specific_heat_j_kg_k / self.cooling_w_kg_k

    @cached_property
    def branches(self) -> tuple[Array, Array, Array]:
        """Ascending enthalpies, J/kg, and the fractions on heating and on cooling at each of them."""
        heat_c = np.linspace(self.austenite_start_c, self.austenite_finish_c, NODES)
        cool_c = np.linspace(self.martensite_finish_c, self.martensite_start_c, NODES)
        heat_xi, cool_xi = heating_branch(self, heat_c), cooling_branch(self, cool_c)
        c, latent = self.specific_heat_j_kg_k, self.latent_heat_j_kg
        heat_h, cool_h = c * heat_c + latent * heat_xi, c * cool_c + latent * cool_xi
        enthalpy = np.union1d(heat_h, cool_h)
        return enthalpy, np.interp(enthalpy, heat_h, heat_xi), np.interp(enthalpy, cool_h, cool_xi)


def heating_branch(spring: SmaSpring, temperature_c: Array) -> Array:
    """Return the fraction on heating, a half cosine from 0 at As to 1 at Af (Liang and Rogers 1990)."""
    return _half_cosine(temperature_c, spring.austenite_start_c, spring.austenite_finish_c)


def cooling_branch(spring: SmaSpring, temperature_c: Array) -> Array:
    """Return the fraction on cooling, a half cosine from 1 at Ms to 0 at Mf (Liang and Rogers 1990)."""
    return _half_cosine(temperature_c, spring.martensite_finish_c, spring.martensite_start_c)


def _half_cosine(temperature_c: Array, low_c: float, high_c: float) -> Array:
    share = (temperature_c - low_c) / (high_c - low_c)
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0))


class SmaState(NamedTuple):
    """State of any number of springs with the same parameters."""

    enthalpy_j_kg: Array  #: H = c T + L xi, shape (..., springs)
    fraction: Array  #: austenite fraction xi in [0, 1], same shape

    @classmethod
    def cold(
        cls, spring: SmaSpring, shape: tuple[int, ...], ambient_c: Array | float | None = None
    ) -> SmaState:
        """Return martensitic springs at `ambient_c` (degC, broadcast; default: `spring.ambient_c`)."""
        enthalpy = spring.specific_heat_j_kg_k * (spring.ambient_c if ambient_c is None else ambient_c)
        return cls(np.full(shape, enthalpy), np.zeros(shape))

    @classmethod
    def at(cls, spring: SmaSpring, temperature_c: Array, fraction: Array) -> SmaState:
        """Return the state at `temperature_c`, with `fraction` clipped to the hysteresis loop."""
        xi = np.clip(
            fraction, heating_branch(spring, temperature_c), cooling_branch(spring, temperature_c)
        )
        return cls(spring.specific_heat_j_kg_k * temperature_c + spring.latent_heat_j_kg * xi, xi)

    def rows(self, rows: Any) -> SmaState:
        """Return the state of some springs or at some steps; `rows` indexes the arrays."""
        return SmaState(self.enthalpy_j_kg[rows], self.fraction[rows])

    def temperature_c(self, spring: SmaSpring) -> Array:
        """Return T = (H - L xi) / c, degC, shape (..., springs)."""
        return (
            self.enthalpy_j_kg - spring.latent_heat_j_kg * self.fraction
        ) / spring.specific_heat_j_kg_k


class SmaSteps(NamedTuple):
    """Result of `advance` for springs of shape S over K steps."""

    path: SmaState  #: after each step, arrays of shape (K,) + S
    power: Array  #: share of the drive power used in each step, shape (K,) + S

    @property
    def state(self) -> SmaState:
        """State after the last step, arrays of shape S."""
        return self.path.rows(-1)


def advance(
    spring: SmaSpring,
    state: SmaState,
    power: Array,
    step_s: float,
    ambient_c: Array | float | None = None,
) -> SmaSteps:
    """Integrate the springs over K steps of `step_s` seconds.

    The method is exponential Euler in H. It is exact while xi and the power are constant. During the
    transformation the relative error of the rate is at most step_s / (2 tau), 0.3 % at 10 ms. At
    `cut_off_c` the driver reduces the power to hold that temperature.

    Args:
        spring: parameters of the springs.
        state: state before the first step, arrays of shape S.
        power: commanded share of the drive power in each step, in [0, 1], shape (K,) + S.
        step_s: length of a step, s.
        ambient_c: air temperature, degC, broadcast to S; `spring.ambient_c` by default.

    Returns:
        The state after each step, and the power used in each step.
    """
    c, latent = spring.specific_heat_j_kg_k, spring.latent_heat_j_kg
    tau = spring.time_constant_s
    span_s = -tau * math.expm1(-step_s / tau)  # step length weighted by the exponential decay
    gain = spring.heating_w_kg * span_s
    decay = spring.cooling_w_kg_k * span_s / c  # of H relative to ambient, at constant xi
    cut_off = c * spring.cut_off_c + latent  # enthalpy at the cut-off, where xi = 1
    shape = power.shape[1:]
    inflow = np.empty(shape)
    inflow[...] = decay * c * (spring.ambient_c if ambient_c is None else ambient_c)
    path = _integrate(
        np.array(state).reshape(2, -1), inflow.ravel(),
        np.ascontiguousarray(power, np.float64).reshape(len(power), -1), spring.branches,
        gain, 1.0 - decay, decay * latent, cut_off,
    )  # fmt: skip
    enthalpy, fraction, used = path.reshape(3, len(power), *shape)
    return SmaSteps(SmaState(enthalpy, fraction), used)


@compiled
def _integrate(
    state: Array,
    inflow: Array,
    power: Array,
    branches: tuple[Array, Array, Array],
    gain: float,
    kept: float,
    released: float,
    cut_off: float,
) -> Array:
    """Integrate N springs over K steps, see `advance`.

    Args:
        state: H and xi before the first step, (2, N).
        inflow: increase of H by the surrounding air in a step, (N,).
        power: commanded share of the drive power in each step, (K, N).
        branches: see `SmaSpring.branches`.
        gain: increase of H in a step at full power.
        kept: coefficient of H in the update of H.
        released: coefficient of xi in the update of H.
        cut_off: H at the cut-off.

    Returns:
        H, xi and the share of the drive power used in each step, (3, K, N).
    """
    nodes, heating, cooling = branches
    path = np.empty((3, *power.shape))
    for i in range(power.shape[1]):
        enthalpy, fraction = state[0, i], state[1, i]
        hot = max(enthalpy, cut_off)
        supply = gain if enthalpy <= cut_off else 0.0  # springs that start above the cut-off get none
        for k in range(power.shape[0]):
            unpowered = enthalpy * kept + fraction * released
            enthalpy = min(unpowered + (power[k, i] * supply + inflow[i]), hot)
            used = (enthalpy - (unpowered + inflow[i])) * (1.0 / gain if gain > 0.0 else 0.0)
            if enthalpy < nodes[0]:
                low, high = heating[0], cooling[0]
            elif enthalpy >= nodes[-1]:
                low, high = heating[-1], cooling[-1]
            else:
                j = np.searchsorted(nodes, enthalpy, "right") - 1
                per_node, rest = 1.0 / (nodes[j + 1] - nodes[j]), enthalpy - nodes[j]
                low = (heating[j + 1] - heating[j]) * per_node * rest + heating[j]
                high = (cooling[j + 1] - cooling[j]) * per_node * rest + cooling[j]
            fraction = min(max(fraction, low), high)
            path[0, k, i], path[1, k, i], path[2, k, i] = enthalpy, fraction, used
    return path


def settle(spring: SmaSpring, power: Array, step_s: float) -> SmaSteps:
    """Simulate a periodic power, starting cold, and return the last period.

    The temperatures are periodic by then, unless the spring needs more than 1000 periods. For the
    arguments, see `advance`; `power` covers one period.
    """
    state = SmaState.cold(spring, power.shape[1:])
    needed = math.ceil(_TIME_CONSTANTS * spring.time_constant_s / (len(power) * step_s))
    for _ in range(min(max(needed, _PERIODS[0]), _PERIODS[1])):
        step = advance(spring, state, power, step_s)
        state = step.state
    return step


def spring_force(spring: SmaSpring, length_m: Array, fraction: Array) -> Array:
    """Return the tension (1 - xi) k_M (l - l_M) + xi k_A (l - l_A), clipped to [0, force_limit_n], N.

    The actuators of `caterpillar_env.model` compute the same force.
    """
    cold = spring.martensite_stiffness_n_m * (length_m - spring.martensite_rest_length_m)
    hot = spring.austenite_stiffness_n_m * (length_m - spring.austenite_rest_length_m)
    return np.clip((1 - fraction) * cold + fraction * hot, 0.0, spring.force_limit_n)
