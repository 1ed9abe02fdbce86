"""The paper's key design parameters of the body: K_1, K_2 and K_3 (Saunders 2009, section III)."""

from __future__ import annotations

from functools import partial

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import GRAVITY_M_S2, Physics
from evolution.priors.preprocessor import DesignParameter

PITCH_ANGLES = 10  #: number of pitch angles over the range of the joints


def roll_stability(segment_mass_kg: Array, leg_separation_m: Array, segment_radius_m: Array) -> Array:
    """Return the minimum lateral force at the centre of mass that tips a segment over, N (eqs 2-4).

    The centre of mass is 2R above the ground and w/2 from the contact point a, so that
    F_phi 2R = m g w / 2.
    """
    width_ratio = leg_separation_m / (2 * segment_radius_m)  # P_w, eq. 4
    return segment_mass_kg * GRAVITY_M_S2 * width_ratio / 2  # eq. 3


def yaw_stability(
    segment_mass_kg: Array, leg_separation_m: Array, attachment_z_m: Array, *, friction: float
) -> Array:
    """Return the minimum lateral force at a spring that turns a segment about one foot, N (eq. 5)."""
    w, z = leg_separation_m, attachment_z_m
    # The minus sign in the paper gives the direction of the force; the magnitude is maximized.
    return friction * segment_mass_kg * GRAVITY_M_S2 * w / (2 * z + w)


def lifting_moment(
    x: Array, y: Array, m: Array, length: Array, *,
    stiffness_n_m: float, rest_length_m: float, radius_m: float, joint_limit_rad: float,
) -> Array:  # fmt: skip
    """Return the mean net moment with which a hot spring lifts a segment about its contact b, N m.

    Saunders 2009, eqs 6-7: M_b = r_b,sp x F_s + r_b,cm x W. The segment extends L/2 ahead of b, its
    centre of mass is h_b = 2R above the ground, and it is pitched up by theta about b. The spring
    connects the anchor, x outboard and y above the centre, to the mirrored anchor on the neighbour,
    which stays level. At theta = 0 it is L + 2x long, and M_b = k (L + 2x - Delta)(y + h_b) - m g L / 2,
    with the stiffness k and the rest length Delta of austenite. The mean is over pitch angles from 0 to
    the joint limit. All values are in SI units.
    """
    height = 2 * radius_m
    total = np.zeros(np.broadcast_shapes(x.shape, y.shape, m.shape, length.shape))
    for theta in np.linspace(0.0, joint_limit_rad, PITCH_ANGLES):
        cosine, sine = np.cos(theta), np.sin(theta)
        # Coordinates in the pitch plane, with origin b: x along the body, z upwards.
        anchor_x = (length / 2 + x) * cosine - (y + height) * sine
        anchor_z = (length / 2 + x) * sine + (y + height) * cosine
        span_x, span_z = -length / 2 - x - anchor_x, y + height - anchor_z
        span = np.hypot(span_x, span_z)
        pull = stiffness_n_m * np.maximum(span - rest_length_m, 0.0)
        spring = (anchor_x * span_z - anchor_z * span_x) * pull / span
        center_x = length / 2 * cosine - height * sine
        total += spring - m * GRAVITY_M_S2 * center_x
    return total / PITCH_ANGLES


def body_parameters(physics: Physics) -> tuple[DesignParameter, ...]:
    """Return the paper's three K_i. Body parameters other than their genes have nominal values."""
    mass, width, spring, nominal = "segment_mass_kg", "leg_separation_m", physics.spring, Morphology()
    yaw = partial(yaw_stability, friction=physics.friction)
    lift = partial(
        lifting_moment,
        stiffness_n_m=spring.austenite_stiffness_n_m, rest_length_m=spring.austenite_rest_length_m,
        radius_m=nominal.segment_radius_m, joint_limit_rad=nominal.joint_limit_rad,
    )  # fmt: skip
    roll_genes, yaw_genes = (mass, width, "segment_radius_m"), (mass, width, "attachment_z_m")
    lift_genes = ("attachment_x_m", "attachment_y_m", mass, "segment_length_m")
    return (
        DesignParameter("roll stability", "eqs 2-4", "N", roll_genes, roll_stability),
        DesignParameter("yaw stability", "eq. 5", "N", yaw_genes, yaw),
        DesignParameter("lifting moment", "eqs 6-7", "N m", lift_genes, lift),
    )
