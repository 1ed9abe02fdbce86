"""Contents and scaling of the observation."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.gait import spring_names
from caterpillar_env.model import joint_names
from caterpillar_env.morphology import NAMES
from caterpillar_env.physics import Physics
from caterpillar_env.pose import BodyState

# Typical magnitudes, by which the entries of an observation are divided.
_AXIAL_SCALE_M = 0.003
_ANGLE_SCALE_RAD = 0.3
_VELOCITY_SCALE_M_S = 0.02
_RATE_SCALE_RAD_S = 1.0
_HEIGHT_SCALE_M = 0.024


def observation_names(physics: Physics, *, clock: bool) -> list[str]:
    """Return the name of each entry of an observation, in order.

    Args:
        physics: determines the number of segments.
        clock: whether to include the phase within the gait period.
    """
    joints = joint_names(physics.num_segments)
    springs = spring_names(physics.num_segments)
    return [
        *(f"position:{j}" for j in joints),
        *(f"velocity:{j}" for j in joints),
        *(f"up:{axis}" for axis in "xyz"),
        "heading:cos",
        "heading:sin",
        "height",
        *(f"linear_velocity:{axis}" for axis in "xyz"),
        *(f"angular_velocity:{axis}" for axis in "xyz"),
        *(f"temperature:{s}" for s in springs),
        *(f"fraction:{s}" for s in springs),
        *(("phase:cos", "phase:sin") if clock else ()),
        *(f"morphology:{n}" for n in NAMES),
    ]


@lru_cache
def _joint_scales(num_segments: int) -> Array:
    """Return the position and velocity scales of the internal joints, (2, J)."""
    axial, hinge = (_AXIAL_SCALE_M, _VELOCITY_SCALE_M_S), (_ANGLE_SCALE_RAD, _RATE_SCALE_RAD_S)
    names = joint_names(num_segments)
    return np.array([axial if name.startswith("axial") else hinge for name in names]).T


def observe(
    physics: Physics,
    state: BodyState,
    heading_rad: Array,
    morphology: Array,
    clock_period_s: float | None,
) -> NDArray[np.float32]:
    """Return the observations of R robots, float32, shape (R, len(observation_names)).

    Args:
        physics: physics of the robots.
        state: positions, velocities and spring states.
        heading_rad: heading relative to the goal heading, rad, (R,).
        morphology: body parameters scaled to [-1, 1], (R, 8).
        clock_period_s: gait period for the phase entries, s; None omits them.
    """
    spring = physics.spring
    position_scale, velocity_scale = _joint_scales(physics.num_segments)
    # Rotate vectors about the vertical into the frame of the current heading.
    heading = np.arctan2(state.forward[:, 1], state.forward[:, 0])[:, None]
    cosine, sine = np.cos(heading), np.sin(heading)
    vectors = np.concatenate([state.up, state.velocity], axis=1).reshape(-1, 3, 3)
    x, y = vectors[..., 0].copy(), vectors[..., 1].copy()
    vectors[..., 0] = cosine * x + sine * y
    vectors[..., 1] = cosine * y - sine * x
    height = state.com_m[:, 2:]
    if not physics.world.level:
        height = height - physics.world.surface(*state.com_m[:, :2].T)[0][:, None]
    parts = [
        state.joint_position / position_scale,
        state.joint_velocity / velocity_scale,
        vectors[:, 0],
        np.cos(heading_rad)[:, None],
        np.sin(heading_rad)[:, None],
        height / _HEIGHT_SCALE_M,
        vectors[:, 1] / _VELOCITY_SCALE_M_S,
        vectors[:, 2] / _RATE_SCALE_RAD_S,
        (state.temperature_c - spring.ambient_c) / (spring.cut_off_c - spring.ambient_c),
        state.fraction,
    ]
    if clock_period_s is not None:
        phase = (2 * np.pi / clock_period_s) * state.time_s[:, None]
        parts += [np.cos(phase), np.sin(phase)]
    parts.append(morphology)
    observed: NDArray[np.float32] = np.concatenate(parts, axis=1).astype(np.float32)
    return observed
