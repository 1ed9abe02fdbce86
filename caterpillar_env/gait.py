"""Gaits: periodic on and off times of the power to each spring (Saunders 2009, section III).

A *gap* is the space between two segments, counted from the head. Springs are numbered gap by gap. Each
gap has four: dorsal left, dorsal right, ventral left, ventral right. A *pair* consists of the left and
the right spring of a gap at the same height. Gap g, counted from 0, has the dorsal pair 2g and the
ventral pair 2g + 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, show, to_array, to_number

#: Default gait period: a spring takes about 1 s to heat and 2.6 s to cool to 10 % austenite. An episode
#: of 30 s has six periods.
GAIT_PERIOD_S = 5.0
SPRINGS_PER_GAP = 4
PAIRS_PER_GAP = 2
MAX_STEPS = 1_000_000  #: largest number of steps in a duration, see `count_steps`
MAX_DUTY = 0.95  #: maximum duty cycle; a spring that is always powered stays contracted


def spring_names(num_segments: int) -> list[str]:
    """Return the spring names in order, e.g. `gap1_dorsal_left`. Gap 1 is behind the head."""
    return [f"{pair}_{side}" for pair in pair_names(num_segments) for side in ("left", "right")]


def pair_names(num_segments: int) -> list[str]:
    """Return the names of the mirrored pairs in order, e.g. `gap1_dorsal`."""
    return [f"gap{g + 1}_{height}" for g in range(num_segments - 1) for height in ("dorsal", "ventral")]


@dataclass(frozen=True, eq=False)
class GaitTimings:
    """On and off times of springs, or of left-right pairs, with a common period.

    A spring is powered from `on_s` to `off_s`. If `off_s` < `on_s`, the powered time continues past the
    end of the period. If both are equal, the spring is never powered.

    Args:
        period_s: gait period, s.
        on_s: switch-on times, s, in [0, period_s], shape (..., springs) or (..., pairs).
        off_s: switch-off times, s, in [0, period_s], same shape.

    Raises:
        CaterpillarError: shapes differ, or a time is not finite or outside [0, period_s].
    """

    period_s: float
    on_s: Array
    off_s: Array

    def __post_init__(self) -> None:
        if (to_number(self.period_s) or 0.0) <= 0:
            raise CaterpillarError(
                f"period_s = {show(self.period_s)} must be a positive number of seconds"
            )
        for name in ("on_s", "off_s"):
            given = to_array(getattr(self, name))
            if given is None:
                raise CaterpillarError(
                    f"{name} must be an array of times; got {show(getattr(self, name))}"
                )
            times = given.copy()
            bad = ~((times >= 0) & (times <= self.period_s))
            if bad.any():
                raise CaterpillarError(
                    f"{name} must lie in [0, {self.period_s:g}] s (the gait period); got {times[bad][0]}"
                )
            times.flags.writeable = False
            object.__setattr__(self, name, times)
        if self.on_s.shape != self.off_s.shape:
            raise CaterpillarError(
                f"on_s and off_s must have the same shape; got {self.on_s.shape} and {self.off_s.shape}"
            )

    @classmethod
    def from_action(cls, action: NDArray[Any], period_s: float) -> GaitTimings:
        """Create timings from an action.

        Args:
            action: on and off time of each of n springs or pairs in turn, shape (..., 2 n). -1 is the
                start of the period and 1 its end; values outside are clipped.
            period_s: gait period, s.
        """
        times = np.clip((np.asarray(action, dtype=np.float64) + 1.0) * 0.5 * period_s, 0.0, period_s)
        return cls(period_s, times[..., 0::2], times[..., 1::2])

    @classmethod
    def from_phases(
        cls, delay: Array, duty: Array, period_s: float, *, springs: bool = False
    ) -> GaitTimings:
        """Create timings from delays and duties, as shares of the period.

        The delay of a dorsal pair counts from the dorsal pair of the gap ahead; in the first gap, it
        counts from the start of the period. The delay of a ventral pair counts from the dorsal pair of
        the same gap. Delays wrap around: 0 and 1 are the same.

        Args:
            delay: delay of each pair, shape (..., pairs).
            duty: powered share of the period, in [0, `MAX_DUTY`], same shape.
            period_s: gait period, s.
            springs: whether `delay` and `duty` have a value for each spring, shape (..., springs),
                instead of each pair. The delay of a left spring counts as for a pair. The delay of
                a right spring counts from the left spring of the same pair.
        """
        sides = SPRINGS_PER_GAP // PAIRS_PER_GAP if springs else 1
        phase = np.array(delay, dtype=np.float64).reshape(*delay.shape[:-1], -1, PAIRS_PER_GAP, sides)
        phase[..., 0, 0] = np.cumsum(phase[..., 0, 0], axis=-1)
        phase[..., 1, 0] += phase[..., 0, 0]
        phase[..., 1:] += phase[..., :1]
        on = phase.reshape(delay.shape)
        return cls(period_s, on % 1.0 * period_s, (on + duty) % 1.0 * period_s)

    def to_phases(self, *, springs: bool = False) -> tuple[Array, Array]:
        """Return delays and duties, as shares of the period in [0, 1), (..., n); see `from_phases`.

        A spring that is always powered gets the duty `MAX_DUTY`.

        Args:
            springs: whether the timings have a value for each spring, instead of each pair.
        """
        sides = SPRINGS_PER_GAP // PAIRS_PER_GAP if springs else 1
        on = (self.on_s / self.period_s).reshape(*self.on_s.shape[:-1], -1, PAIRS_PER_GAP, sides)
        delay = on.copy()
        delay[..., 1:] -= on[..., :1]
        delay[..., 1, 0] -= on[..., 0, 0]
        delay[..., 1:, 0, 0] -= on[..., :-1, 0, 0]
        always = self.off_s - self.on_s == self.period_s
        duty = np.where(always, MAX_DUTY, (self.off_s - self.on_s) / self.period_s % 1.0)
        return delay.reshape(self.on_s.shape) % 1.0, duty

    def to_action(self) -> NDArray[np.float32]:
        """Return the action for these timings, shape (..., 2 n), float32; see `from_action`."""
        return (2.0 * self.times_s / self.period_s - 1.0).astype(np.float32)

    @property
    def times_s(self) -> Array:
        """On and off time of each spring or pair in turn, s, shape (..., 2 n)."""
        return np.stack([self.on_s, self.off_s], axis=-1).reshape(*self.on_s.shape[:-1], -1)

    def __getitem__(self, rows: Any) -> GaitTimings:
        """Return the timings of some robots, indexed like arrays: `timings[2]`, `timings[None]`."""
        return GaitTimings(self.period_s, self.on_s[rows], self.off_s[rows])

    def mirrored(self) -> GaitTimings:
        """Return timings of springs, (..., springs), from timings of pairs, (..., pairs)."""
        on_s, off_s = np.repeat([self.on_s, self.off_s], SPRINGS_PER_GAP // PAIRS_PER_GAP, axis=-1)
        return GaitTimings(self.period_s, on_s, off_s)

    def of_springs(self, num_springs: int) -> GaitTimings:
        """Return the timings of all springs. Timings of pairs apply to both springs of each pair.

        Raises:
            CaterpillarError: the number of times matches neither the springs nor the pairs.
        """
        given = self.on_s.shape[-1] if self.on_s.ndim else 0
        if given == num_springs:
            return self
        if given * SPRINGS_PER_GAP != num_springs * PAIRS_PER_GAP:
            raise CaterpillarError(
                f"a gait must have times of {num_springs} springs or {num_springs // 2} left-right "
                f"pairs; got times of {given}"
            )
        return self.mirrored()

    def power(self, step_s: float) -> Array:
        """Return the share of each step in which the power is on, over one period.

        Args:
            step_s: length of a step, s. The period must be a multiple of it.

        Returns:
            Values in [0, 1], shape (..., steps, springs).

        Raises:
            CaterpillarError: the period is not a multiple of `step_s`.
        """
        steps = count_steps(self.period_s, step_s, "the gait period")
        edges = np.linspace(0.0, self.period_s, steps + 1)[:, None]
        on, off = self.on_s[..., None, :], self.off_s[..., None, :]
        # Time between on and off (if wrapped: off and on) that has passed since the start of the period.
        inside = np.clip(edges, np.minimum(on, off), np.maximum(on, off))
        powered = np.where(off >= on, inside, edges - inside)
        return np.clip(np.diff(powered, axis=-2) / (self.period_s / steps), 0.0, 1.0)


def count_steps(duration_s: float, step_s: float, what: str) -> int:
    """Return the number of steps in a duration.

    Raises:
        CaterpillarError: the duration, called `what`, is not a positive multiple of `step_s`, or it has
            more than `MAX_STEPS` steps.
    """
    duration, step = to_number(duration_s), to_number(step_s)
    shown = f"{show(duration_s)} s" if duration is None else f"{duration:g} s"
    steps = duration / step if duration is not None and step else 0.0
    count = round(steps) if 0 < steps < 2 * MAX_STEPS else 0
    if not 1 <= count <= MAX_STEPS:
        raise CaterpillarError(
            f"{what} of {shown} must be a whole multiple of {step_s} s, 1 to {MAX_STEPS:,} times as long"
        )
    if abs(count * step_s - duration_s) > 1e-9 * max(1.0, duration_s):
        raise CaterpillarError(f"{what} of {shown} must be a whole multiple of {step_s:g} s")
    return count
