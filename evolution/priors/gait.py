"""Key design parameters of the gait in the manner of the paper: K_4, stroke, and K_5, advance.

Both predict how a wave of contractions should look, from the thermal model of the springs and from
statics. No simulated result enters them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.gait import PAIRS_PER_GAP, GaitTimings
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.sma import SmaSpring, settle
from evolution.priors.preprocessor import DesignParameter
from evolution.priors.statics import PlanarChain

INSTANTS = 100  #: instants of a period at which the shape of the robot is computed
_SEGMENTS = 4  #: of the robot in K_5, which predicts how neighbouring gaps should follow each other


def gait_parameters(physics: Physics, gait_period_s: float) -> tuple[DesignParameter, ...]:
    """Return K_4 and K_5. The body in K_5 is nominal, as for the genes outside of the paper's K_i."""
    chain = replace(physics, num_segments=_SEGMENTS, spring_strengths=None, mismatch_seed=0)
    return _make_parameters(chain, gait_period_s)


@lru_cache(maxsize=8)
def _make_parameters(physics: Physics, gait_period_s: float) -> tuple[DesignParameter, ...]:
    """Return the same objects for the same arguments, so that `search_grid` runs once for them."""
    k_4 = partial(stroke, spring=physics.spring, gait_period_s=gait_period_s)
    k_5 = partial(advance, physics=physics, gait_period_s=gait_period_s)
    return (
        DesignParameter("stroke", "thermal model", "", ("duty",), k_4),
        DesignParameter("advance", "planar statics", "m", ("lag", "offset", "duty"), k_5),
    )


def stroke(duty: Array, *, spring: SmaSpring, gait_period_s: float) -> Array:
    """Return the swing of the austenite fraction over a settled period, same shape as `duty`."""
    fraction = _settled_fraction(duty.ravel(), spring, gait_period_s)
    swing: Array = np.ptp(fraction, axis=0).reshape(duty.shape)
    return swing


def advance(lag: Array, offset: Array, duty: Array, *, physics: Physics, gait_period_s: float) -> Array:
    """Return the net advance of a crawling wave in one period, m.

    Args:
        lag: delay of a dorsal pair after that of the gap ahead, share of the period.
        offset: delay of a ventral pair after the dorsal pair of its gap, share of the period.
        duty: powered share of the period, of all pairs.
        physics: material and number of segments.
        gait_period_s: gait period.
    """
    shape = np.broadcast_shapes(lag.shape, offset.shape, duty.shape)
    lag, offset = (np.broadcast_to(a, shape).ravel() for a in (lag, offset))
    duties, which = np.unique(np.broadcast_to(duty, shape).ravel(), return_inverse=True)
    settled = _settled_fraction(duties, physics.spring, gait_period_s)  # (steps, duties)
    gaps = physics.num_segments - 1
    delays = [gap * lag + height * offset for gap in range(gaps) for height in range(PAIRS_PER_GAP)]
    time = np.arange(INSTANTS + 1)[:, None] / INSTANTS
    fractions = np.empty((len(time), len(delays), lag.size))
    for pair, delay in enumerate(delays):
        steps = ((time - delay) % 1.0 * len(settled)).astype(int) % len(settled)
        fractions[:, pair] = settled[steps, which]
    positions_m = PlanarChain(Morphology(), physics).crawl(fractions, gait_period_s / INSTANTS)
    net_m: Array = (positions_m[-1] - positions_m[0]).reshape(shape)
    return net_m


def _settled_fraction(duty: Array, spring: SmaSpring, gait_period_s: float) -> Array:
    """Return the austenite fraction after each thermal step of a settled period, (steps, D)."""
    timings = GaitTimings(gait_period_s, np.zeros_like(duty), duty * gait_period_s)
    return settle(spring, timings.power(SMA_STEP_S), SMA_STEP_S).fraction
