"""Our key design parameters of the gait: K_4, the stroke, and K_5, the advance.

The paper has no K_i for the gait. K_4 follows from the thermal model of the springs, and K_5 also from
a planar quasi-static model of the robot. Neither is fitted to simulated distances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.gait import MAX_DUTY, PAIRS_PER_GAP, SPRINGS_PER_GAP, GaitTimings
from caterpillar_env.morphology import Body, Morphology
from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.sma import SmaSpring, settle
from caterpillar_env.worlds import Flat
from evolution.genome import Encoding
from evolution.priors.preprocessor import DesignParameter
from evolution.priors.statics import PlanarChain

INSTANTS = 100  #: instants of a period at which the shape of the robot is computed
_SEGMENTS = 4  #: number of segments of the robot in K_5


def gait_parameters(physics: Physics, gait_period_s: float) -> tuple[DesignParameter, ...]:
    """Return K_4 and K_5.

    K_5 describes the nominal body with four segments and equal springs on flat ground, whatever the
    robot and the world of the run.
    """
    chain = replace(
        physics, num_segments=_SEGMENTS, spring_strengths=None, mismatch_seed=0,
        timestep_s=Physics.timestep_s, world=Flat(),
    )  # fmt: skip
    return _make_parameters(chain, gait_period_s)


@lru_cache(maxsize=8)
def _make_parameters(physics: Physics, gait_period_s: float) -> tuple[DesignParameter, ...]:
    """Return K_4 and K_5: the same objects for the same arguments, so that `search_grid` is cached."""
    k_4 = partial(stroke, spring=physics.spring, gait_period_s=gait_period_s)
    k_5 = partial(_advance_of_wave, physics=physics, gait_period_s=gait_period_s)
    return (
        DesignParameter("stroke", "thermal model", "", ("duty",), k_4),
        DesignParameter("advance", "planar statics", "m", ("lag", "offset", "duty"), k_5),
    )


def stroke(duty: Array, *, spring: SmaSpring, gait_period_s: float) -> Array:
    """Return the peak-to-peak austenite fraction in the periodic steady state, same shape as `duty`."""
    fraction = _settled_fraction(duty.ravel(), spring, gait_period_s)
    swing: Array = np.ptp(fraction, axis=0).reshape(duty.shape)
    return swing


def advance(bodies: Sequence[Body], timings: GaitTimings, physics: Physics) -> Array:
    """Return the net advance of P robots in one gait period, m, shape (P,).

    The springs are in the periodic steady state: their temperatures repeat.

    Args:
        bodies: P bodies, or one for all gaits.
        timings: gaits of the springs, or of mirrored pairs, shape (P, springs or pairs).
        physics: material and number of segments.
    """
    period_s, gaps = timings.period_s, physics.num_segments - 1
    springs = timings.of_springs(SPRINGS_PER_GAP * gaps)
    powered_s = springs.off_s - springs.on_s
    duty = np.where(powered_s == period_s, 1.0, powered_s / period_s % 1.0)
    duties, which = np.unique(duty, return_inverse=True)
    settled = _settled_fraction(duties, physics.spring, period_s)  # (steps, duties)
    time = np.arange(INSTANTS + 1)[:, None, None] / INSTANTS
    steps = ((time - springs.on_s / period_s) % 1.0 * len(settled)).astype(int) % len(settled)
    fractions = settled[steps, which.reshape(springs.on_s.shape)]
    # The planar model has one spring for each left-right pair.
    pairs = fractions.reshape(*fractions.shape[:2], PAIRS_PER_GAP * gaps, -1).mean(axis=3)
    chain = PlanarChain(bodies, physics)
    positions_m = chain.crawl(np.moveaxis(pairs, 1, 2), period_s / INSTANTS)
    net_m: Array = positions_m[-1] - positions_m[0]
    return net_m


def _advance_of_wave(
    lag: Array, offset: Array, duty: Array, *, physics: Physics, gait_period_s: float
) -> Array:
    """Return the advance of the nominal body with a wave, m. For the genes, see `evolution.genome`."""
    waves = Encoding(physics, gait_period_s, timing="wave")
    lag, offset, duty = np.broadcast_arrays(lag, offset, duty / MAX_DUTY)
    gaits = np.stack([lag, duty, offset, duty], axis=-1).reshape(-1, 4)
    genomes = np.concatenate([np.tile(Morphology().to_unit(), (len(gaits), 1)), gaits], axis=1)
    _, timings = waves.decode(genomes)
    return advance([Morphology()], timings, physics).reshape(lag.shape)


def _settled_fraction(duty: Array, spring: SmaSpring, gait_period_s: float) -> Array:
    """Return the austenite fraction after each step of a period in steady state, (steps, D)."""
    timings = GaitTimings(gait_period_s, np.zeros_like(duty), duty * gait_period_s)
    return settle(spring, timings.power(SMA_STEP_S), SMA_STEP_S).path.fraction
