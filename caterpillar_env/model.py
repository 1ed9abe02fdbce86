"""The robot as a MuJoCo model: a chain of rigid elements with joints, springs and feet.

World axes are x forward, y left, z up. Segment 0 is the head. A segment consists of a legged element
and a plain element behind it, connected by a prismatic and a revolute joint. Segments are connected by
pitch hinges with a viscoelastic moment (Saunders 2009, section III and fig. 7).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import numpy as np

from caterpillar_env.drawing.scenery import add_cameras, add_scenery, remove_ruler_picture
from caterpillar_env.engine import set_options
from caterpillar_env.gait import SPRINGS_PER_GAP, spring_names
from caterpillar_env.ground import FOOT, ROBOT, SKIN, STANCE_M, add_ground, condim
from caterpillar_env.morphology import Body, Morphology, segments_of
from caterpillar_env.physics import Physics
from caterpillar_env.sma import SmaSpring

FOOT_RADIUS_M = 0.002
ELEMENTS_PER_SEGMENT = 2
#: Impedance of the joint stops at first contact and at full penetration. The stops are nearly rigid.
_STOP_IMPEDANCE = (0.99, 0.999)
_BEND_AXES = {"yaw": [0, 0, 1], "pitch": [0, 1, 0]}


def joint_names(num_segments: int) -> list[str]:
    """Return the names of the internal joints from head to tail, in the order of `qpos` and `qvel`."""
    names = []
    for segment in range(num_segments):
        names += [f"neck{segment - 1}"] if segment else []
        names += [f"axial{segment}", f"bend{segment}"]
    return names


def build_model(body: Body, physics: Physics, *, scenery: bool = True) -> mujoco.MjModel:
    """Compile a robot that stands straight along x at the start of its world.

    On uneven ground, it is not yet at the right height; `Simulation` raises or lowers it.

    Args:
        body: one morphology, or one per segment. All segments stand on their feet. If the axes of two
            segments differ in height, the neck is halfway between the two axes.
        physics: material, numerics and number of segments.
        scenery: whether to add cameras, light, ground texture, ruler and legs for drawing. They cause
            most of the build time and memory use.

    Returns:
        A model whose array sizes do not depend on `body`. Bodies are `element0` (head) to
        `element{2N-1}`. Tendons and actuators are named by `gait.spring_names`. The control is the
        austenite fraction, in [0, 1].
    """
    return ModelBuilder(physics, scenery=scenery).build(body)


def model_xml(body: Body, physics: Physics, *, scenery: bool = True) -> str:
    """Return a robot as MJCF, for use in MuJoCo without this package.

    For the arguments, see `build_model`. Numbers have full precision, so the XML compiles to the same
    model. Only the ruler's texture and the effect of `trim_tendons` are missing. In the world `rough`,
    the simulation also lifts the robot at the start.
    """
    builder = ModelBuilder(physics, scenery=scenery)
    builder.build(body)
    spec: Any = builder.spec
    if scenery:
        remove_ruler_picture(spec)
    spec.compiler.savecompiled = False  # compiled values have fewer digits
    return str(spec.to_xml())


class ModelBuilder:
    """Compiles robots with the same physics and different bodies; arguments as in `build_model`.

    Creating an `MjSpec` takes longer than compiling it. The builder therefore keeps the spec of the
    first robot, and for further robots updates only the attributes that depend on the body.
    """

    def __init__(self, physics: Physics, *, scenery: bool = True) -> None:
        self._physics, self._scenery = physics, scenery
        self._segments: tuple[Morphology, ...] = ()
        self.spec: mujoco.MjSpec | None = None  #: spec of the last robot
        self._parts: list[Any] = []  # the robot's parts in the spec, in the order of creation
        self._existing: Iterator[Any] = iter(())  # parts not yet updated for the body

    def build(self, body: Body) -> mujoco.MjModel:
        """Compile a robot."""
        self._segments = segments_of(body, self._physics.num_segments)
        self._existing = iter(tuple(self._parts))
        is_new = self.spec is None
        if self.spec is None:
            self.spec = _new_spec(self._physics)
        self._add_robot(self.spec)
        if is_new:  # after the robot, so that its elements get the first body indices
            ground = add_ground(self.spec, self._physics.world)
            if self._scenery:
                add_scenery(self.spec, ground, level=self._physics.world.level)
        model = self.spec.compile()
        trim_tendons(model)
        return model

    def _part(self, add: Callable[..., Any], fixed: dict[str, Any], **variable: Any) -> Any:
        """Add a part by calling `add`, or update the `variable` attributes of the existing one."""
        part = next(self._existing, None)
        if part is None:
            part = add(**fixed, **variable)
            self._parts.append(part)
        else:
            for name, value in variable.items():
                setattr(part, name, value)
        return part

    def _add_robot(self, spec: mujoco.MjSpec) -> None:
        parent = spec.worldbody
        for index in range(self._physics.num_segments * ELEMENTS_PER_SEGMENT):
            segment, plain = divmod(index, ELEMENTS_PER_SEGMENT)
            m = self._segments[segment]
            if index == 0:
                # The centre of mass is 2R above the ground (Saunders 2009, eqs. 3 and 4).
                position = [0.0, 0.0, 2 * m.segment_radius_m - STANCE_M]
            elif plain:
                position = [-m.segment_length_m / 2, 0.0, 0.0]
            else:
                position = _neck_offset(self._segments[segment - 1], m)
            element = self._part(parent.add_body, {"name": f"element{index}"}, pos=position)
            if index == 0:
                self._part(element.add_freejoint, {"name": "root"})
            elif plain:
                self._add_intra_segment_joints(element, segment)
            else:
                self._add_neck(element, segment)
            self._add_shell(element, index, m)
            if not plain:
                self._add_feet(element, segment, m)
                self._add_anchors(element, segment, m)
            parent = element
        if self._scenery:
            head, up = spec.body("element0"), self._physics.world.up
            add_cameras(head, self._segments, up, self._part)

    def _add_shell(self, body: mujoco.MjsBody, index: int, m: Morphology) -> None:
        shade = 1.0 if index % ELEMENTS_PER_SEGMENT == 0 else 0.8
        green = [0.5 * shade, 0.8 * shade, 0.35 * shade, 0.25]
        self._part(
            body.add_geom,
            {
                "name": f"shell{index}", "type": mujoco.mjtGeom.mjGEOM_ELLIPSOID, "conaffinity": SKIN,
                "rgba": [0.95, 0.85, 0.3, 0.25] if index == 0 else green,
            },
            size=[m.segment_length_m / 4, m.segment_radius_m, m.segment_radius_m],
            mass=m.segment_mass_kg / ELEMENTS_PER_SEGMENT,
        )  # fmt: skip

    def _add_intra_segment_joints(self, body: mujoco.MjsBody, segment: int) -> None:
        p, m = self._physics, self._segments[segment]
        middle = [m.segment_length_m / 4, 0, 0]
        travel = p.axial_range * m.segment_length_m
        # At rest, the pre-tension of the cold springs compresses the segment to its length L.
        stretch = 0.0
        if segment < p.num_segments - 1:
            stretch = pretension(m, self._segments[segment + 1], p.spring) / p.axial_stiffness_n_m
        self._part(
            body.add_joint,
            {
                "name": f"axial{segment}", "type": mujoco.mjtJoint.mjJNT_SLIDE, "axis": [-1, 0, 0],
                "stiffness": [p.axial_stiffness_n_m, 0, 0], "damping": [p.axial_damping_n_s_m, 0, 0],
            },
            pos=middle, springref=stretch, range=[-travel, travel],
        )  # fmt: skip
        self._part(
            body.add_joint,
            {
                "name": f"bend{segment}", "type": mujoco.mjtJoint.mjJNT_HINGE,
                "axis": _BEND_AXES[p.bend_axis],
                "damping": [p.bend_ratio * p.neck_damping_n_m_s_rad, 0, 0],
            },
            pos=middle, range=[-m.joint_limit_rad, m.joint_limit_rad],
            stiffness=self._hinge_stiffness(p.bend_ratio, m.joint_limit_rad),
        )  # fmt: skip

    def _add_neck(self, body: mujoco.MjsBody, segment: int) -> None:
        p, ahead, behind = self._physics, self._segments[segment - 1], self._segments[segment]
        up = _neck_offset(ahead, behind)[2]
        limit = (ahead.joint_limit_rad + behind.joint_limit_rad) / 2
        self._part(
            body.add_joint,
            {
                "name": f"neck{segment - 1}", "type": mujoco.mjtJoint.mjJNT_HINGE, "axis": [0, 1, 0],
                "damping": [p.neck_damping_n_m_s_rad, 0, 0],
            },
            pos=[behind.segment_length_m / 4, 0, -up / 2], range=[-limit, limit],
            stiffness=self._hinge_stiffness(1.0, limit),
        )  # fmt: skip

    def _hinge_stiffness(self, ratio: float, limit_rad: float) -> list[float]:
        """Return the polynomial coefficients of a hinge's stiffness, for `ratio` necks in parallel.

        The moment is k q (1 + s (q / limit)^2), because silicone stiffens towards the limit.
        """
        linear = ratio * self._physics.neck_stiffness_n_m_rad
        return [linear, 0.0, linear * self._physics.neck_stiffening / limit_rad**2]

    def _add_feet(self, body: mujoco.MjsBody, segment: int, m: Morphology) -> None:
        """Add feet and, with scenery, massless legs without contacts."""
        for side, sign in (("left", 1), ("right", -1)):
            lateral = sign * m.leg_separation_m / 2
            foot = [0, lateral, FOOT_RADIUS_M - 2 * m.segment_radius_m]
            self._part(
                body.add_geom,
                {
                    "name": f"foot{segment}_{side}", "type": mujoco.mjtGeom.mjGEOM_SPHERE,
                    "size": [FOOT_RADIUS_M, 0, 0], "mass": 0, "rgba": [0.2, 0.2, 0.2, 1],
                    "conaffinity": FOOT,
                },
                pos=foot,
            )  # fmt: skip
            if self._scenery:
                self._part(
                    body.add_geom,
                    {
                        "type": mujoco.mjtGeom.mjGEOM_CAPSULE, "size": [0.0012, 0, 0], "mass": 0,
                        "rgba": [0.3, 0.35, 0.3, 1],
                    },
                    fromto=[0, lateral * 0.6, 0, *foot],
                )  # fmt: skip

    def _add_anchors(self, body: mujoco.MjsBody, segment: int, m: Morphology) -> None:
        """Add the attachments of the springs.

        Springs to the segment behind are attached at the front. Springs to the segment ahead are
        attached at the rear. As in the paper, the parameter y is vertical and z lateral, whereas the
        axis y of the body points to the left, and its axis z up.
        """
        ends = [("front", 1)] if segment < self._physics.num_segments - 1 else []
        ends += [("rear", -1)] if segment > 0 else []
        for side, sign in (("left", 1), ("right", -1)):
            for height, up in (("dorsal", 1), ("ventral", -1)):
                for end, along in ends:
                    name = f"anchor{segment}_{end}_{height}_{side}"
                    position = [
                        along * m.attachment_x_m, sign * m.attachment_z_m, up * m.attachment_y_m
                    ]  # fmt: skip
                    self._part(body.add_site, {"name": name}, pos=position)


def trim_tendons(model: mujoco.MjModel) -> None:
    """Reduce each spring's Jacobian to the joints between the two elements that it connects.

    MuJoCo stores a column for every joint from the ends of a tendon to the root, although the columns of
    joints above both ends are always zero. The Newton solver processes all columns in each iteration.
    Trimming makes a step more than twice as fast.
    """
    ends = np.sort(model.site_bodyid[model.wrap_objid].reshape(-1, 2), axis=1)
    inside = np.searchsorted(model.dof_bodyid, ends, side="right")  # first degree of freedom, last + 1
    for tendon, (first, last) in enumerate(inside.tolist()):
        address = model.ten_J_rowadr[tendon]  # rows keep their address and become shorter
        model.ten_J_colind[address : address + last - first] = range(first, last)
    model.ten_J_rownnz[:] = inside[:, 1] - inside[:, 0]


def _neck_offset(ahead: Morphology, behind: Morphology) -> list[float]:
    """Return the offset from the plain element of a segment to the legged element of the next, m."""
    length = (ahead.segment_length_m + behind.segment_length_m) / 4
    return [-length, 0.0, 2 * behind.segment_radius_m - 2 * ahead.segment_radius_m]


def pretension(ahead: Morphology, behind: Morphology, spring: SmaSpring) -> float:
    """Return the axial force of the four cold springs between two segments of a straight body, N.

    Between identical segments, springs have the length L + 2x and are parallel to the body.
    """
    along, _, up = _neck_offset(ahead, behind)
    spaced = ahead.segment_length_m / 2 - along + (ahead.attachment_x_m + behind.attachment_x_m)
    pull = 0.0
    for height in (1, -1):  # dorsal and ventral pair
        rise = up + height * (behind.attachment_y_m - ahead.attachment_y_m)
        length = math.hypot(spaced, rise, behind.attachment_z_m - ahead.attachment_z_m)
        tension = spring.martensite_stiffness_n_m * (length - spring.martensite_rest_length_m)
        pull += 2 * min(max(tension, 0.0), spring.force_limit_n) * (spaced / length)
    return pull


def _new_spec(p: Physics) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    set_options(spec, p)
    _set_defaults(spec, p)
    _add_springs(spec, p)
    return spec


def _set_defaults(spec: mujoco.MjSpec, p: Physics) -> None:
    """Set the defaults of geoms, joints, tendons and actuators. Geoms collide with the ground only."""
    default = spec.default
    default.geom.contype, default.geom.conaffinity, default.geom.condim = 0, 0, condim(p.friction)
    default.geom.friction, default.geom.priority = [p.friction, 0, 0], ROBOT
    default.geom.solref[:2] = [p.contact_time_constant_s, 1]
    default.joint.solref_limit[:2] = [p.stop_time_constant_s, 1]
    default.joint.solimp_limit[:2] = _STOP_IMPEDANCE
    default.joint.limited = True
    default.site.size, default.site.rgba = [0.0008, 0, 0], [0.2, 0.2, 0.2, 1]
    default.tendon.width, default.tendon.rgba = 0.001, [0.3, 0.45, 0.8, 1]
    spring = default.actuator
    spring.trntype = mujoco.mjtTrn.mjTRN_TENDON
    spring.gaintype = mujoco.mjtGain.mjGAIN_AFFINE
    spring.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    spring.ctrllimited, spring.ctrlrange = True, [0, 1]
    spring.forcelimited = True


def _add_springs(spec: mujoco.MjSpec, p: Physics) -> None:
    s, strengths = p.spring, p.strengths()
    cold, hot = s.martensite_stiffness_n_m, s.austenite_stiffness_n_m
    for index, name in enumerate(spring_names(p.num_segments)):
        gap, side = index // SPRINGS_PER_GAP, name.split("_", 1)[1]
        tendon = spec.add_tendon(name=name)
        tendon.wrap_site(f"anchor{gap}_front_{side}")
        tendon.wrap_site(f"anchor{gap + 1}_rear_{side}")
        # The force is affine in the length and in the control xi, as in `sma.spring_force`.
        k = float(strengths[index])
        actuator = spec.add_actuator(name=name, target=name, forcerange=[-k * s.force_limit_n, 0])
        actuator.biasprm[:3] = [k * cold * s.martensite_rest_length_m, -k * cold, 0]
        gain = k * (hot * s.austenite_rest_length_m - cold * s.martensite_rest_length_m)
        actuator.gainprm[:3] = [gain, -k * (hot - cold), 0]
