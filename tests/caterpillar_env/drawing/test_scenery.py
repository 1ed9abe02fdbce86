from typing import get_args

import mujoco
import numpy as np
import pytest

from caterpillar_env.drawing.scenery import _PIXELS_PER_CM, _RULER_CM, RULER, Camera, _ruler_picture
from caterpillar_env.model import build_model
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics

PHYSICS = Physics()


def built(body=None, **kwargs):
    return build_model(body or Morphology(), PHYSICS, **kwargs)


def test_cameras_follow_the_robot_and_look_at_it():
    model = built()
    assert tuple(model.camera(i).name for i in range(model.ncam)) == get_args(Camera)
    assert (model.cam_mode == mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM).all()
    data = mujoco.MjData(model)
    data.qpos[:2] = 1.0, -0.5
    mujoco.mj_forward(model, data)
    for place, axes in zip(data.cam_xpos, data.cam_xmat.reshape(-1, 3, 3), strict=True):
        towards = data.subtree_com[1] - place
        cosine = -axes[:, 2] @ towards / np.linalg.norm(towards)
        assert cosine > np.cos(np.radians(8))
        np.testing.assert_allclose(axes[:, 0], [1, 0, 0], atol=1e-9)  # forwards is to the right


@pytest.mark.parametrize("length_m", [0.022, 0.036])
def test_whole_body_is_in_view(length_m):
    model = built(Morphology(segment_length_m=length_m))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    shells = [model.geom(f"shell{i}").id for i in range(8)]
    for camera in range(model.ncam):
        seen = (data.geom_xpos[shells] - data.cam_xpos[camera]) @ data.cam_xmat[camera].reshape(3, 3)
        angle = np.degrees(np.arctan(np.abs(seen[:, :2]) / -seen[:, 2:]))
        assert angle[:, 0].max() < 25  # half the width of a 4:3 image is 26 degrees
        assert angle[:, 1].max() < 20


def test_scenery_does_not_change_the_motion():
    ends = []
    for scenery in (True, False):
        model = built(scenery=scenery)
        data = mujoco.MjData(model)
        data.ctrl[:3] = 1.0
        for _ in range(200):
            mujoco.mj_step(model, data)
        ends.append(data.qpos.copy())
    np.testing.assert_array_equal(*ends)
    assert not np.allclose(ends[0], data.model.qpos0)


def test_ruler_has_a_tick_per_centimetre_and_the_right_length():
    width, height, pixels = _ruler_picture()
    picture = np.frombuffer(pixels, dtype=np.uint8).reshape(height, width, 3)
    dark = picture[height // 8, :, 0] < 100  # all ticks cross this row above the numbers
    ticks = np.flatnonzero(dark[1:] & ~dark[:-1])[:-1]  # the last one is the edge
    np.testing.assert_allclose(np.diff(ticks), _PIXELS_PER_CM, atol=1)
    assert len(ticks) == _RULER_CM[1] - _RULER_CM[0] - 1
    ruler = built().geom(RULER)
    assert 2 * ruler.size[0] == pytest.approx(width / _PIXELS_PER_CM / 100)
    assert ruler.pos[0] - ruler.size[0] == pytest.approx(_RULER_CM[0] / 100)
    assert ruler.contype[0] == ruler.conaffinity[0] == 0
