"""3D view of the robot: the geometry of its model, with springs coloured by temperature."""

from __future__ import annotations

import mujoco
import numpy as np
from viser import FrameHandle, LineSegmentsHandle, SceneApi

from caterpillar_env.arrays import Array
from caterpillar_env.drawing.overlay import spring_rgb
from caterpillar_env.drawing.scenery import rotation_to
from caterpillar_env.model import ELEMENTS_PER_SEGMENT, build_model
from caterpillar_env.morphology import Body
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot
from caterpillar_env.worlds import EXTENT_X_M, EXTENT_Y_M, World

_MESH_M = 0.005  # grid spacing of uneven ground
_GROUND_M = 4.0  # side length of the ground; no robot crawls 2 m in 30 s


class RobotScene:
    """The ground and one robot."""

    def __init__(self, scene: SceneApi) -> None:
        self._scene = scene
        self._world = scene.add_frame("/world", show_axes=False)
        self._robot: FrameHandle | None = None
        self._built: tuple[Body, Physics] | None = None
        self._turn = np.eye(3)  # from the ground's frame to the view's frame, in which z is up

    def draw(self, robot: Robot, qpos: Array, temperature_c: Array) -> None:
        """Draw a robot in place of the previous one. The ground moves, so that the robot stays in view.

        Args:
            robot: robot to draw; its gait is ignored.
            qpos: generalized positions, (nq,); a pose with non-finite values is skipped.
            temperature_c: spring temperatures, degC, (num_springs,).
        """
        if (robot.morphology, robot.physics) != self._built:
            self._build(robot)
        if not np.isfinite(qpos).all():
            return
        model, data = self._model, self._data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        parts = slice(1, 1 + len(self._elements))
        for element, position, wxyz in zip(
            self._elements, data.xpos[parts], data.xquat[parts], strict=True
        ):
            element.position, element.wxyz = position, wxyz
        self._springs.points = data.site_xpos[self._ends].astype(np.float32)
        colours = np.round(255 * spring_rgb(robot.physics.spring, temperature_c)[:, None])
        self._springs.colors = np.repeat(colours.astype(np.uint8), 2, axis=1)
        middle = data.xpos[parts].mean(axis=0)
        ground_m, _ = robot.physics.world.surface(middle[0], middle[1])
        self._world.position = -self._turn @ [middle[0], middle[1], ground_m]

    def _build(self, robot: Robot) -> None:
        if self._robot is not None:
            self._robot.remove()
        if self._built is None or self._built[1].world != robot.physics.world:
            self._build_ground(robot.physics.world)
        self._built = (robot.morphology, robot.physics)
        model = build_model(robot.morphology, robot.physics)
        self._model, self._data = model, mujoco.MjData(model)
        self._robot = self._scene.add_frame("/world/robot", show_axes=False)
        self._elements = [
            self._scene.add_frame(f"/world/robot/{model.body(i).name}", show_axes=False)
            for i in range(1, 1 + ELEMENTS_PER_SEGMENT * robot.physics.num_segments)
        ]
        for geom in range(model.ngeom):
            if 0 < model.geom_bodyid[geom] <= len(self._elements):  # not the ground
                self._add_geom(geom)
        self._ends = model.wrap_objid.reshape(-1, 2)  # two sites per tendon
        self._springs: LineSegmentsHandle = self._scene.add_line_segments(
            "/world/robot/springs",
            points=np.zeros((model.ntendon, 2, 3)),
            colors=np.zeros((model.ntendon, 2, 3), dtype=np.uint8),
            thickness=2 * float(model.tendon_width[0]),
        )

    def _build_ground(self, world: World) -> None:
        """Draw the ground: a grid on level ground, or a mesh."""
        self._turn = rotation_to(world.up).T
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, self._turn.ravel())
        self._world.wxyz = quaternion
        if world.level:
            self._scene.add_grid(
                "/world/ground", width=_GROUND_M, height=_GROUND_M, cell_size=0.01, section_size=0.1,
                cell_color=(170, 178, 170), section_color=(120, 130, 120), plane_color=(222, 228, 222),
                plane_opacity=1.0, fade_distance=2.0,
            )  # fmt: skip
            return
        columns, rows = (np.arange(low, high, _MESH_M) for low, high in (EXTENT_X_M, EXTENT_Y_M))
        x, y = (side.ravel() for side in np.meshgrid(columns, rows))
        corners = np.arange(x.size).reshape(len(rows), len(columns))
        a, b, c, d = (
            part.ravel()
            for part in (corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1])
        )
        faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        vertices = np.stack([x, y, world.surface(x, y)[0]], axis=1)
        self._scene.add_mesh_simple(
            "/world/ground", vertices.astype(np.float32), faces.astype(np.uint32),
            color=(196, 204, 196), flat_shading=True,
        )  # fmt: skip

    def _add_geom(self, geom: int) -> None:
        model = self._model
        shape = mujoco.mjtGeom(model.geom_type[geom])
        *colour, opacity = model.geom_rgba[geom].tolist()
        size = model.geom_size[geom].tolist()
        name = f"/world/robot/{model.body(model.geom_bodyid[geom]).name}/geom{geom}"
        common = {
            "color": tuple(colour), "opacity": opacity if opacity < 1 else None,
            "position": model.geom_pos[geom], "wxyz": model.geom_quat[geom],
        }  # fmt: skip
        if shape == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            self._scene.add_icosphere(name, scale=tuple(size), **common)
        elif shape == mujoco.mjtGeom.mjGEOM_SPHERE:
            self._scene.add_icosphere(name, radius=size[0], **common)
        else:  # leg: a cylinder, because body and foot hide the ends of the capsule
            self._scene.add_cylinder(name, radius=size[0], height=2 * size[1], **common)
