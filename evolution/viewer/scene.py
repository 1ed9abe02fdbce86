"""3D view of the robot: the geometry of its model, with springs coloured by temperature."""

from __future__ import annotations

import mujoco
import numpy as np
from viser import FrameHandle, LineSegmentsHandle, SceneApi

from caterpillar_env.arrays import Array
from caterpillar_env.drawing.overlay import spring_rgb
from caterpillar_env.model import build_model
from caterpillar_env.morphology import Body
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot

_GROUND_M = 4.0  # side length of the ground; no robot crawls 2 m in 30 s


class RobotScene:
    """The ground and one robot."""

    def __init__(self, scene: SceneApi) -> None:
        self._scene = scene
        self._world = scene.add_frame("/world", show_axes=False)
        self._robot: FrameHandle | None = None
        self._built: tuple[Body, Physics] | None = None
        scene.add_grid(
            "/world/ground", width=_GROUND_M, height=_GROUND_M, cell_size=0.01, section_size=0.1,
            cell_color=(170, 178, 170), section_color=(120, 130, 120), plane_color=(222, 228, 222),
            plane_opacity=1.0, fade_distance=2.0,
        )  # fmt: skip

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
        for element, position, wxyz in zip(self._elements, data.xpos[1:], data.xquat[1:], strict=True):
            element.position, element.wxyz = position, wxyz
        self._springs.points = data.site_xpos[self._ends].astype(np.float32)
        colours = np.round(255 * spring_rgb(robot.physics.spring, temperature_c)[:, None])
        self._springs.colors = np.repeat(colours.astype(np.uint8), 2, axis=1)
        middle = data.xpos[1:].mean(axis=0)
        self._world.position = (-middle[0], -middle[1], 0.0)

    def _build(self, robot: Robot) -> None:
        if self._robot is not None:
            self._robot.remove()
        self._built = (robot.morphology, robot.physics)
        model = build_model(robot.morphology, robot.physics)
        self._model, self._data = model, mujoco.MjData(model)
        self._robot = self._scene.add_frame("/world/robot", show_axes=False)
        self._elements = [
            self._scene.add_frame(f"/world/robot/{model.body(i).name}", show_axes=False)
            for i in range(1, model.nbody)
        ]
        for geom in range(model.ngeom):
            if model.geom_bodyid[geom]:  # not the ground
                self._add_geom(geom)
        self._ends = model.wrap_objid.reshape(-1, 2)  # two sites per tendon
        self._springs: LineSegmentsHandle = self._scene.add_line_segments(
            "/world/robot/springs",
            points=np.zeros((model.ntendon, 2, 3)),
            colors=np.zeros((model.ntendon, 2, 3), dtype=np.uint8),
            thickness=2 * float(model.tendon_width[0]),
        )

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
        else:  # leg: body and foot hide the ends of its capsule
            self._scene.add_cylinder(name, radius=size[0], height=2 * size[1], **common)
