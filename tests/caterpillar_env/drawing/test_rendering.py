import os
import re
import subprocess
import sys
import warnings
from typing import get_args

import mujoco
import numpy as np
import pytest

from caterpillar_env import CaterpillarEnv, CaterpillarVectorEnv, Morphology, Physics
from caterpillar_env.drawing import rendering
from caterpillar_env.drawing.rendering import Pictures, RobotRenderer, View, choose_backend
from caterpillar_env.drawing.scenery import RULER, Camera
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.task import Crawl

VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")
CONTACT_RGB = (1.0, 0.55, 0.05)
pytestmark = pytest.mark.drawing
WIDTH, HEIGHT = 96, 64
SMALL = Morphology(segment_length_m=0.022, segment_radius_m=0.009)


def drawing_env(render_mode, **kwargs):
    env = CaterpillarEnv(
        render_mode=render_mode, width=WIDTH, height=HEIGHT, gait_period_s=0.5, **kwargs
    )
    env.reset(seed=0)
    return env


def is_picture(frame):
    return frame.shape == (HEIGHT, WIDTH, 3) and frame.dtype == np.uint8 and frame.std() > 10


# Robot


@pytest.fixture(scope="module")
def renderer():
    """Renderer of the nominal robot, shared because contexts are slow to create."""
    made = RobotRenderer(Morphology(), Physics(), View(WIDTH, HEIGHT))
    yield made
    made.close()


@pytest.fixture
def start(renderer):
    return renderer.model.qpos0.copy()


def draw(renderer, qpos, temperature_c=25.0):
    return renderer.draw(qpos, np.full(12, temperature_c)).astype(int)


def count_pixels(picture, rgb):
    """Return the number of pixels with the hue of a colour, at any brightness."""
    wanted = np.array(rgb) / np.max(rgb)
    own = picture / np.maximum(picture.max(axis=2, keepdims=True), 1)
    return int((np.abs(own - wanted).max(axis=2) < 0.12).sum())


def test_hot_springs_are_redder(renderer, start):
    change = draw(renderer, start, 120.0) - draw(renderer, start, 25.0)
    assert change[..., 0].sum() > 100
    assert change[..., 2].sum() < -100


def test_pose_is_drawn(renderer, start):
    bent = start.copy()
    bent[[9, 12, 15]] = 0.4
    changed = np.abs(draw(renderer, bent) - draw(renderer, start)).max(axis=2) > 10
    assert changed.mean() > 0.02


def test_camera_follows_the_robot(renderer, start):
    far = start.copy()
    far[0] += 3.0  # a whole number of pairs of squares
    ruler = renderer.model.geom(RULER)
    ruler.pos[0] += 3.0
    moved = draw(renderer, far)
    ruler.pos[0] -= 3.0
    assert np.abs(moved - draw(renderer, start)).mean() < 3


def test_contacts_with_the_ground_are_marked(renderer, start):
    raised = start.copy()
    raised[2] += 0.001
    assert count_pixels(draw(renderer, start), CONTACT_RGB) > 15
    assert count_pixels(draw(renderer, raised), CONTACT_RGB) == 0


def test_ruler_shows_the_distance(renderer, start):
    ruler = renderer.model.geom(RULER)
    zero_m = ruler.pos[0] - ruler.size[0] + 0.5  # it begins at -50 cm
    assert zero_m == pytest.approx(renderer.centre_of_mass(start)[0])
    assert zero_m < -0.02  # the head starts at the origin, and the centre of mass behind it


def test_ruler_stays_beside_a_robot_that_veers(renderer, start):
    veered = start.copy()
    veered[1] += 0.12  # a whole number of pairs of squares
    assert np.abs(draw(renderer, veered) - draw(renderer, start)).mean() < 3


# Rows of a simulation


def test_each_row_is_drawn_with_its_body():
    crawl = Crawl([Morphology(), SMALL], Physics(), 1)
    pictures = Pictures(crawl, View(WIDTH, HEIGHT))
    frames = [pictures.draw(row) for row in (0, 1)]
    assert [pictures.renderer(row).body for row in (0, 1)] == [Morphology(), SMALL]
    kept = pictures.renderer(0)
    crawl.reset([SMALL], np.array([0]))
    changed = pictures.draw(0)
    assert pictures.renderer(0) is not kept
    pictures.close()
    assert np.abs(frames[0].astype(int) - frames[1]).max() > 50
    assert np.abs(changed.astype(int) - frames[1]).max() < 10


# Environment


def test_rgb_array_is_a_picture_that_changes_even_after_closing():
    env = drawing_env("rgb_array")
    first = env.render()
    env.step(np.tile([-1.0, 1.0], 6))
    second = env.render()
    env.close()
    env.close()
    again = env.render()
    env.close()
    assert is_picture(first)
    assert (first != second).any()
    assert np.abs(again.astype(int) - second).max() < 10


def test_frame_rate_of_single_frames_is_the_step_rate():
    assert CaterpillarEnv(render_mode="rgb_array", gait_period_s=2.0).metadata["render_fps"] == 0.5
    assert CaterpillarEnv.metadata["render_fps"] == 10  # the class attribute is unchanged


def test_new_body_is_drawn():
    env = drawing_env("rgb_array")
    old = env.render()
    env.reset(options={"morphology": SMALL})
    new = env.render()
    env.close()
    assert (new != old).any()


def test_vector_environment_draws_every_row():
    envs = CaterpillarVectorEnv(
        2, render_mode="rgb_array", width=WIDTH, height=HEIGHT, morphology=[Morphology(), SMALL]
    )
    envs.reset(seed=0)
    frames = envs.render()
    envs.reset(options={"morphology": SMALL, "reset_mask": np.array([True, False])})
    again = envs.render()
    envs.close()
    assert len(frames) == 2
    assert all(is_picture(f) for f in frames)
    assert np.abs(frames[0].astype(int) - frames[1]).max() > 50
    assert np.abs(again[0].astype(int) - frames[1]).max() < 10


def test_nothing_is_drawn_without_a_render_mode():
    for env in (CaterpillarEnv(), CaterpillarVectorEnv(2)):
        env.reset(seed=0)
        with pytest.warns(UserWarning, match="render_mode"):
            assert env.render() is None


@pytest.mark.parametrize("camera", get_args(Camera))
def test_every_camera_shows_the_robot_differently(camera):
    env = drawing_env("rgb_array", camera_name=camera)
    picture = env.render().astype(int)
    env.close()
    assert is_picture(picture.astype(np.uint8))
    head = (picture[..., 0] > picture[..., 2] + 40) & (picture[..., 1] > picture[..., 2] + 25)
    assert head.sum() > 20  # yellow
    assert np.flatnonzero(head.any(axis=0)).max() > WIDTH // 2  # to the right


@pytest.mark.parametrize("kind", [CaterpillarEnv, CaterpillarVectorEnv])
@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"camera_name": "front"}, "camera_name = 'front' must be one of track, side, top"),
        ({"width": 0}, "width = 0 must be an integer from 1 to 8192"),
        ({"height": 4.5}, "height = 4.5 must be an integer"),
    ],
)
def test_invalid_views_are_rejected_at_once(kind, wrong, match):
    with pytest.raises(CaterpillarError, match=match) as error:
        kind(render_mode="rgb_array", **wrong)
    assert error.type is CaterpillarError  # and not an error of this machine


def test_images_can_be_larger_than_the_models_buffer():
    env = CaterpillarEnv(render_mode="rgb_array", width=2000, height=40)
    env.reset(seed=0)
    picture = env.render()
    env.close()
    assert picture.shape == (40, 2000, 3)


# Backends


@pytest.fixture
def headless(monkeypatch):
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)


def test_default_is_egl(headless):
    assert choose_backend() == "egl"


@pytest.mark.parametrize(("name", "chosen"), [("DISPLAY", "glfw"), ("MUJOCO_GL", "mine")])
def test_display_and_environment_variable_take_precedence(name, chosen, headless, monkeypatch):
    monkeypatch.setenv(name, "mine")
    assert choose_backend() == chosen


def run(code):
    """Run a program without a display and without MUJOCO_GL."""
    environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)


def test_importing_changes_no_environment_variable():
    run(
        "import gymnasium, os\n"  # Gymnasium sets its own variable
        "before = dict(os.environ)\n"
        "import caterpillar_env.env, caterpillar_env.drawing.video\n"
        "assert dict(os.environ) == before"
    )


def test_rendering_works_without_a_display_after_importing_mujoco():
    run(
        "import mujoco, caterpillar_env\n"
        "env = caterpillar_env.CaterpillarEnv(render_mode='rgb_array', width=64, height=48)\n"
        "env.reset(seed=0)\n"
        "assert env.render().std() > 10"
    )


# Machines that cannot draw


@pytest.fixture
def broken(monkeypatch):
    """Make rendering fail, and return the list of attempts."""
    tried = []

    def fail(*args):
        tried.append(args)
        raise RuntimeError("no device\nand more of it")

    monkeypatch.setattr(mujoco, "Renderer", fail)
    monkeypatch.setattr(rendering, "unavailable", None)
    return tried


def test_everything_except_rendering_works_with_one_warning(broken):
    action = np.tile([-1.0, 1.0], 6)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("default")
        env = drawing_env("rgb_array")
        assert env.render() is None
        env.step(action)
        envs = CaterpillarVectorEnv(2, render_mode="rgb_array")
        envs.reset(seed=0)
        assert envs.render() is None
        envs.close()
    assert len(warned) == 1
    assert re.search(r"cannot draw \(.*no device\); install EGL", str(warned[0].message))
    assert len(broken) == 1  # a second attempt may crash Python


def test_drawing_can_be_switched_off(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "off")
    monkeypatch.setattr(rendering, "unavailable", None)
    with pytest.warns(UserWarning, match="unset MUJOCO_GL, which disables rendering"):
        assert drawing_env("rgb_array").render() is None


@pytest.mark.parametrize("world", ["slope", "steps", "rough", "patches"])
def test_every_world_is_drawn(world):
    frames = {}
    for name in ("flat", world):
        env = drawing_env("rgb_array", morphology=SMALL, world=name)
        frames[name] = env.render()
        env.close()
        assert is_picture(frames[name])
    assert np.abs(frames["flat"].astype(int) - frames[world]).mean() > 1
