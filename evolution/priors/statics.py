"""A planar, quasi-static model of the crawling robot, for the key design parameter K_5.

The robot is reduced to its sagittal plane: a chain of segments with a pitch hinge (neck) between
neighbours. Each segment but the last has a prismatic joint; segments are rigid otherwise. The left and
the right spring of a pair act as one. At each instant, a few Newton iterations move the chain towards
the shape of minimum energy,

    E = springs + necks + prismatic joints + gravity + compression of the feet
        + sum over feet of friction * load * |displacement since the last instant|,

plus the work of the dampers in the joints. There is no inertia. The sum over feet is Coulomb friction:
the feet slide in the way that dissipates least. The absolute value is smoothed over `SLIP_M`, and the
loads are those of the previous iteration.

Many chains are solved together. The last axis of the arrays is the index of the chain.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.model import ELEMENTS_PER_SEGMENT, pretension
from caterpillar_env.morphology import Body, Morphology, segments_of
from caterpillar_env.physics import GRAVITY_M_S2, Physics
from caterpillar_env.sma import spring_force

SLIP_M = 3e-4  #: displacement since the last instant over which friction builds up
FOOT_STIFFNESS_N_M = 400.0  #: stiffness of a pair of feet, which carries about 0.08 N
NECK_STOP_N_M_RAD = 3.0  #: stiffness of a neck beyond its limit
AXIAL_STOP_N_M = 2e4  #: stiffness of a prismatic joint beyond its travel
ITERATIONS = 3  #: Newton iterations per instant
FIRST_ITERATIONS = 40  #: Newton iterations for the first instant, from a straight chain


class _Vectors(NamedTuple):
    """Coefficients of V vectors: sum over segments j of (along - slide s_j) e_j + above n_j.

    e_j points forward along segment j, n_j upward from it, and s_j is the extension of its prismatic
    joint. All arrays have the shape (V, N, bodies). The vectors are the positions of the feet, the sum
    of weight times centre over all elements, and the vectors from end to end of the springs.
    """

    along_m: Array
    above_m: Array
    slide: Array


class Geometry(NamedTuple):
    """Positions of G chains."""

    vectors_m: Array  #: see `_Vectors`, (2, V, G)
    jacobian: Array  #: derivatives of the vectors with respect to the coordinates, (2, V, n, G)
    along_m: Array  #: `_Vectors.along_m` minus the extensions of the prismatic joints, (V, N, G)
    forward: Array  #: e_j, (2, N, G)
    upward: Array  #: n_j, (2, N, G)


class PlanarChain:
    """The model of one body with G gaits, or of G bodies with a gait each.

    The n = 2 N + 1 coordinates of a chain of N segments are the position x, z of the centre of the
    head's legged element, the pitch of each segment, and the extension of each prismatic joint but the
    last.

    Args:
        bodies: one body, or G bodies.
        physics: material and number of segments.
    """

    def __init__(self, bodies: Sequence[Body], physics: Physics) -> None:
        self._physics, self._feet = physics, physics.num_segments
        self._pitches, self._slides = np.split(np.arange(2, 2 * self._feet + 1), [self._feet])
        chains = [segments_of(body, self._feet) for body in bodies]
        self._vectors = _Vectors(*np.stack([_list_vectors(chain) for chain in chains], axis=-1))
        self._height_m = np.array([2 * head.segment_radius_m for head, *_ in chains])
        self._weight_n = GRAVITY_M_S2 * np.array([sum(m.segment_mass_kg for m in c) for c in chains])
        # Properties of the necks and of the prismatic joints, (N - 1, bodies).
        gaps = [list(itertools.pairwise(chain)) for chain in chains]
        limits = [[(a.joint_limit_rad + b.joint_limit_rad) / 2 for a, b in body] for body in gaps]
        self._limit_rad = np.array(limits).T
        self._travel_m = physics.axial_range * np.array(
            [[m.segment_length_m for m in chain[:-1]] for chain in chains]
        ).T  # fmt: skip
        pull = [[pretension(a, b, physics.spring) for a, b in body] for body in gaps]
        # Extension without load: the pre-tension of the cold springs then compresses a segment to its
        # nominal length.
        self._stretch_m = np.array(pull).T / physics.axial_stiffness_n_m
        # Largest changes in a Newton step, and the values added to the Hessian's diagonal.
        pitches, slides = self._feet, self._feet - 1
        self._largest = np.array([0.01, 0.005] + pitches * [0.15] + slides * [0.002])[:, None]
        self._regularization = np.diag([1e-2, 1e-2] + pitches * [1e-3] + slides * [1e-2])

    def crawl(self, fractions: Array, interval_s: float) -> Array:
        """Return the position of the head, m, at each of K instants, (K, G).

        Args:
            fractions: austenite fraction of each pair of springs, (K, pairs, G).
            interval_s: time from one instant to the next.
        """
        q = self.settle(fractions[0])
        positions_m = [q[0]]
        for fraction in fractions[1:]:
            start, (feet_m, heights_m) = q, self.locate(q).vectors_m[:, : self._feet]
            load_n = _load_n(heights_m)
            for _ in range(ITERATIONS):
                q, load_n = self._improve(q, start, fraction, feet_m, load_n, interval_s)
            positions_m.append(q[0])
        return np.array(positions_m)

    def settle(self, fraction: Array) -> Array:
        """Return the coordinates at rest, (n, G), for fractions (pairs, G), from a straight chain."""
        load_n = np.zeros((self._feet, fraction.shape[1])) + self._weight_n / self._feet
        q = np.zeros((2 * self._feet + 1, fraction.shape[1]))
        q[1] = self._height_m - load_n[0] / FOOT_STIFFNESS_N_M
        feet_m = self.locate(q).vectors_m[0, : self._feet]
        for _ in range(FIRST_ITERATIONS):
            q, load_n = self._improve(q, q, fraction, feet_m, load_n, 1.0)
        return q

    def loads_n(self, q: Array) -> Array:
        """Return the load on each pair of feet, (N, G)."""
        return _load_n(self.locate(q).vectors_m[1, : self._feet])

    def locate(self, q: Array) -> Geometry:
        """Return the positions of chains with the coordinates q, (n, G)."""
        v, pitch = self._vectors, q[self._pitches]
        slides_m = np.zeros_like(pitch)
        slides_m[:-1] = q[self._slides]
        along_m = v.along_m - v.slide * slides_m
        forward = np.stack([np.cos(pitch), np.sin(pitch)])
        upward = np.stack([-forward[1], forward[0]])
        vectors_m = (along_m * forward[:, None] + v.above_m * upward[:, None]).sum(axis=2)
        vectors_m[:, : self._feet] += q[:2, None]
        vectors_m[:, self._feet] += self._weight_n * q[:2]
        jacobian = np.zeros((*vectors_m.shape[:2], *q.shape))
        for axis in range(2):
            jacobian[axis, : self._feet, axis] = 1.0
            jacobian[axis, self._feet, axis] = self._weight_n
        jacobian[:, :, self._pitches] = along_m * upward[:, None] - v.above_m * forward[:, None]
        jacobian[:, :, self._slides] = -(v.slide * forward[:, None])[:, :, :-1]
        return Geometry(vectors_m, jacobian, along_m, forward, upward)

    def _improve(
        self, q: Array, start: Array, fraction: Array, feet_m: Array, load_n: Array, interval_s: float
    ) -> tuple[Array, Array]:
        """Return the coordinates after one Newton iteration, and the loads of the feet before it."""
        at = self.locate(q)
        force, stiffness, load_n = self._load(at, fraction, feet_m, load_n)
        gradient = np.einsum("kvg,kvng->ng", force, at.jacobian)
        weighted = np.einsum("klvg,lvng->kvng", stiffness, at.jacobian)
        hessian = np.einsum("kvng,kvmg->nmg", at.jacobian, weighted)
        self._add_curvature(hessian, at, force)
        self._add_joints(gradient, hessian, q, start, interval_s)
        matrices = hessian.transpose(2, 0, 1) + self._regularization
        step = -np.linalg.solve(matrices, gradient.T[..., None])[..., 0].T
        return q + step / np.maximum((np.abs(step) / self._largest).max(axis=0), 1.0), load_n

    def _load(
        self, at: Geometry, fraction: Array, feet_m: Array, load_n: Array
    ) -> tuple[Array, Array, Array]:
        """Return the loads of the feet, and the derivatives of the energy with respect to the vectors.

        Returns:
            The gradient (2, V, G), the Hessian (2, 2, V, G), and the loads (N, G).
        """
        feet, spring = self._feet, self._physics.spring
        force = np.zeros_like(at.vectors_m)
        stiffness = np.zeros((2, *force.shape))
        force[1, feet] = 1.0  # gradient of gravity: this vector is a sum of weighted positions
        foot_x_m, foot_z_m = at.vectors_m[:, :feet]
        moved_m = foot_x_m - feet_m
        friction = self._physics.friction * load_n / np.hypot(moved_m, SLIP_M)
        load_n = _load_n(foot_z_m)
        force[0, :feet], force[1, :feet] = friction * moved_m, -load_n
        stiffness[0, 0, :feet], stiffness[1, 1, :feet] = friction, FOOT_STIFFNESS_N_M * (load_n > 0)
        span_m = at.vectors_m[:, feet + 1 :]
        length_m = np.hypot(*span_m)
        unit = span_m / length_m
        tension = 2 * spring_force(spring, length_m, fraction)  # of a left and a right spring
        cold, hot = spring.martensite_stiffness_n_m, spring.austenite_stiffness_n_m
        free = (tension > 0) & (tension < 2 * spring.force_limit_n)
        rate = 2 * ((1 - fraction) * cold + fraction * hot) * free
        across = tension / length_m
        force[:, feet + 1 :] = tension * unit
        stiffness[:, :, feet + 1 :] = (rate - across) * unit[:, None] * unit
        stiffness[0, 0, feet + 1 :] += across
        stiffness[1, 1, feet + 1 :] += across
        return force, stiffness, load_n

    def _add_curvature(self, hessian: Array, at: Geometry, force: Array) -> None:
        """Add the forces times the second derivatives of the vectors with respect to the pitches.

        Negative values are left out. The Hessian is then positive definite, and every step is downhill.
        """
        along = (force[:, :, None] * at.forward[:, None]).sum(axis=0)  # (V, N, G)
        up = (force[:, :, None] * at.upward[:, None]).sum(axis=0)
        turned = -(at.along_m * along + self._vectors.above_m * up).sum(axis=0)
        hessian[self._pitches, self._pitches] += np.maximum(turned, 0.0)

    def _add_joints(
        self, gradient: Array, hessian: Array, q: Array, start: Array, interval_s: float
    ) -> None:
        """Add the moments of the necks and the forces of the prismatic joints."""
        p = self._physics
        angle = np.diff(q[self._pitches], axis=0)
        bent = p.neck_stiffening * (angle / self._limit_rad) ** 2
        damping = p.neck_damping_n_m_s_rad / interval_s
        beyond = angle - np.clip(angle, -self._limit_rad, self._limit_rad)
        turned = angle - np.diff(start[self._pitches], axis=0)
        moment = p.neck_stiffness_n_m_rad * (1 + bent) * angle
        moment += NECK_STOP_N_M_RAD * beyond + damping * turned
        rate = p.neck_stiffness_n_m_rad * (1 + 3 * bent) + NECK_STOP_N_M_RAD * (beyond != 0) + damping
        ahead, behind = self._pitches[:-1], self._pitches[1:]
        gradient[ahead] -= moment
        gradient[behind] += moment
        hessian[ahead, ahead] += rate
        hessian[behind, behind] += rate
        hessian[ahead, behind] -= rate
        hessian[behind, ahead] -= rate

        slide_m = q[self._slides]
        beyond = slide_m - np.clip(slide_m, -self._travel_m, self._travel_m)
        damping = p.axial_damping_n_s_m / interval_s
        gradient[self._slides] += (
            p.axial_stiffness_n_m * (slide_m - self._stretch_m)
            + AXIAL_STOP_N_M * beyond
            + damping * (slide_m - start[self._slides])
        )
        rate = p.axial_stiffness_n_m + AXIAL_STOP_N_M * (beyond != 0) + damping
        hessian[self._slides, self._slides] += rate


def _list_vectors(segments: Sequence[Morphology]) -> Array:
    """Return the coefficients of the vectors of one body, (3, V, N); see `_Vectors`."""
    feet = [_point(segments, i, 0.0, -2 * m.segment_radius_m) for i, m in enumerate(segments)]
    weights = np.zeros((3, len(segments)))
    for i, m in enumerate(segments):
        legged = _point(segments, i, 0.0, 0.0)
        plain = _point(segments, i, -m.segment_length_m / 2, 0.0, slide=1.0)
        weights += m.segment_mass_kg / ELEMENTS_PER_SEGMENT * GRAVITY_M_S2 * (legged + plain)
    springs = [
        _point(segments, gap + 1, -behind.attachment_x_m, side * behind.attachment_y_m)
        - _point(segments, gap, ahead.attachment_x_m, side * ahead.attachment_y_m)
        for gap, (ahead, behind) in enumerate(itertools.pairwise(segments))
        for side in (1, -1)
    ]
    return np.stack([*feet, weights, *springs], axis=1)


def _point(
    segments: Sequence[Morphology], index: int, along_m: float, above_m: float, slide: float = 0.0
) -> Array:
    """Return the coefficients, (3, N), of a point relative to the centre of the first legged element."""
    point = np.zeros((3, len(segments)))
    for ahead in range(index):  # to the neck, and from there to the next legged element
        m, behind = segments[ahead], segments[ahead + 1]
        rise_m = behind.segment_radius_m - m.segment_radius_m
        point[:, ahead] += -3 / 4 * m.segment_length_m, rise_m, 1.0
        point[:2, ahead + 1] += -behind.segment_length_m / 4, rise_m
    point[:, index] += along_m, above_m, slide
    point[2, -1] = 0.0  # the last prismatic joint is rigid
    return point


def _load_n(height_m: Array) -> Array:
    """Return the load on feet at a height above the ground; a negative height compresses them."""
    load: Array = FOOT_STIFFNESS_N_M * np.maximum(-height_m, 0.0)
    return load
