"""The replay: encoded poses match the recording, and a browser shows, plays and rotates them."""

import base64
import io
import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from PIL import Image

from caterpillar_env.drawing.video import Recording
from caterpillar_env.gait import GaitTimings
from caterpillar_env.model import build_model
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot
from evolution import cli
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.report.replay import encode
from evolution.run.evaluators import LocalEvaluator
from evolution.run.loop import evolve

PHYSICS = Physics(num_segments=2, timestep_s=0.01)


@pytest.fixture(scope="module")
def recording():
    timings = GaitTimings(5.0, np.array([0.0, 0.1]), np.array([0.6, 0.7]))
    return Recording(Robot(Morphology(), timings, PHYSICS))


@pytest.fixture(scope="module")
def data(recording):
    """The replay as the page gets it."""
    return json.loads(json.dumps(encode(recording)))


def unpack(data, name, kind, *shape):
    array = np.frombuffer(base64.b64decode(data[name]), dtype=kind)
    return array.reshape(-1, *shape).astype(float)


def test_poses_match_the_simulation(recording, data):
    poses = unpack(data, "poses", "<i2", data["elements"], 7)
    model = build_model(recording.robot.morphology, recording.robot.physics)
    state = mujoco.MjData(model)
    assert len(poses) == 1500
    for frame in (0, 700, 1499):
        state.qpos[:] = recording.qpos[2 * frame + 1]
        mujoco.mj_kinematics(model, state)
        np.testing.assert_allclose(data["scale_m"] * poses[frame, :, :3], state.xpos[1:], atol=1e-5)
        np.testing.assert_allclose(poses[frame, :, 3:] / 32767, state.xquat[1:], atol=1e-4)


def test_final_readings_match_the_episode(recording, data):
    x_m, _, energy_j = unpack(data, "track", "<f4", 3)[-1]
    assert x_m - data["start_m"] == pytest.approx(recording.outcomes.distance_m[0], abs=3e-4)
    assert energy_j == pytest.approx(recording.outcomes.energy_j[0])
    assert data["duration_s"] == 30.0
    assert data["interval_s"] == 0.02


def test_springs_have_the_colours_of_their_temperatures(recording, data):
    heat = unpack(data, "heat", "u1", 4)
    spring = recording.robot.physics.spring
    share = (recording.temperature_c[1::2] - spring.ambient_c) / (spring.cut_off_c - spring.ambient_c)
    np.testing.assert_allclose(heat / 63, share, atol=0.5 / 63 + 1e-9)
    assert heat.max() > 20
    assert data["palette"][0] == "#1a59f2"  # blue
    assert data["palette"][-1] == "#eb1914"  # red


def test_feet_touch_the_ground_and_shells_do_not(data):
    touching = [shape for shape in data["shapes"] if shape["touching"]]
    touches = unpack(data, "touches", "u1", len(touching))
    feet = np.array([shape["opacity"] == 1 for shape in touching])
    assert feet.sum() == 4
    assert touches[0, feet].all()
    assert touches[:, feet].mean() > 0.5
    assert touches[:, ~feet].mean() < 0.05


def test_shapes_match_the_body(data):
    shell, *_ = (shape for shape in data["shapes"] if shape["opacity"] < 1)
    np.testing.assert_allclose(shell["axes"], np.diag([0.0075, 0.012, 0.012]), atol=1e-9)
    legs = [shape["ends"] for shape in data["shapes"] if "ends" in shape]
    assert len(legs) == 4
    lowest = [min(end[2] for end in leg) for leg in legs]
    assert lowest == pytest.approx([0.002 - 0.024] * 4)
    assert len(data["springs"]) == 4


@pytest.mark.parametrize("world", ["flat", "slope:angle_deg=20", "steps", "rough"])
def test_ground_matches_the_world(recording, world):
    physics = replace(PHYSICS, world=world)
    data = encode(Recording(replace(recording.robot, physics=physics)))
    poses = unpack(data, "poses", "<i2", data["elements"], 7)
    assert data["elements"] == 4
    assert len(data["shapes"]) == 4 + 4 + 4  # no part of the ground
    assert np.abs(data["scale_m"] * poses[..., :3]).max() < 1.0
    np.testing.assert_allclose(np.array(data["upright"])[:, 2], physics.world.up)
    if physics.world.level:
        assert data["ground"] is None
        return
    ground = data["ground"]
    heights = unpack(ground, "heights_um", "<i4", ground["columns"])
    row, column = 20, 30
    x, y = ground["x_m"] + column * ground["cell_m"], ground["y_m"] + row * ground["cell_m"]
    height, _ = physics.world.surface(np.array(x), np.array(y))
    assert heights[row, column] == pytest.approx(1e6 * height, abs=0.5)
    assert np.ptp(heights) > 1000


def test_long_robots_have_fewer_frames(recording):
    physics = replace(PHYSICS, num_segments=64)
    robot = Robot(Morphology(), GaitTimings(5.0, np.zeros(126), np.zeros(126)), physics)
    model = build_model(robot.morphology, physics)
    long = Recording.__new__(Recording)  # a robot at rest, because simulating it is slow
    long.robot, long.body_length_m = robot, 64 * 0.03
    long.qpos = np.tile(model.qpos0, (3000, 1))
    long.temperature_c, long.energy_j = np.full((3000, 252), 25.0), np.zeros(3000)
    data = encode(long)
    assert len(json.dumps(data)) < 1e6
    frames = len(unpack(data, "track", "<f4", 3))
    assert 29 < frames * data["interval_s"] <= 30


# In a browser


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The page of a run, without a video."""
    folder = tmp_path_factory.mktemp("replay") / "run"
    config = RunConfig(seed=4, generations=1, physics=PHYSICS, ga=GaConfig(population=3, hall_of_fame=1))
    evolve(config, folder, evaluator=LocalEvaluator(1))
    assert cli.main(["report", str(folder), "--no-video"]) == 0
    return folder / "report.html"


class Tab:
    """The page in one browser tab."""

    def __init__(self, browser, page, width_px=1280):
        self.errors = []
        self.page = browser.new_page(viewport={"width": width_px, "height": 900})
        self.page.on("console", lambda message: self.errors.append(message.text))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(page.as_uri())
        self.canvas, self.play = self.page.locator("#replay-canvas"), self.page.locator("#replay-play")
        self.canvas.scroll_into_view_if_needed()
        self.page.wait_for_function("document.getElementById('replay-readout').textContent !== ''")

    def picture(self):
        """The pixels of the canvas on white."""
        url = self.page.evaluate(
            """new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() =>
                done(document.getElementById('replay-canvas').toDataURL()))))"""
        )
        drawn = Image.open(io.BytesIO(base64.b64decode(url.split(",")[1])))
        paper = Image.new("RGBA", drawn.size, "white")
        return np.asarray(Image.alpha_composite(paper, drawn).convert("RGB")).astype(int)

    def time_s(self):
        return float(self.page.locator("#replay-readout").inner_text().split(" s")[0])

    def seek(self, share):
        self.page.evaluate(
            """share => {
                const slider = document.getElementById('replay-time');
                slider.value = share * slider.max;
                slider.dispatchEvent(new Event('input'));
            }""",
            share,
        )

    def close(self):
        self.page.close()
        assert self.errors == []


def differing(first, second):
    """Share of the pixels that differ."""
    return float((np.abs(first - second).max(axis=2) > 30).mean())


@pytest.mark.slow
@pytest.mark.parametrize("width_px", [1280, 390])
def test_play_moves_the_robot_until_the_end(browser, page, width_px):
    tab = Tab(browser, page, width_px)
    start = tab.picture()
    red, green, blue = start.transpose(2, 0, 1)
    assert ((green > red + 8) & (green > blue + 20)).mean() > 0.01  # shells
    assert ((red > 200) & (blue < 80)).mean() > 0.001  # spots below the feet
    assert tab.page.locator("#replay-readout").inner_text() == "0.0 s   0 mm   0 J"
    tab.page.locator("#replay-speed").select_option("4")
    tab.play.click()
    tab.page.wait_for_function("parseFloat(document.getElementById('replay-readout').textContent) > 2")
    tab.play.click()
    assert tab.play.inner_text() == "Play"
    paused_s = tab.time_s()
    assert differing(start, tab.picture()) > 0.002  # 0 for a still picture
    assert tab.time_s() == paused_s
    tab.seek(0.98)
    tab.play.click()
    tab.page.wait_for_function("document.getElementById('replay-play').textContent === 'Play'")
    assert tab.time_s() == 30.0
    tab.play.click()  # from the start
    assert tab.time_s() < 15.0
    tab.close()


@pytest.mark.slow
def test_robot_can_be_turned_and_zoomed(browser, page):
    tab = Tab(browser, page)
    tab.seek(0.5)
    home = tab.picture()
    box = tab.canvas.bounding_box()
    mouse, middle = tab.page.mouse, (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    mouse.move(*middle)
    scrolled = tab.page.evaluate("scrollY")
    mouse.wheel(0, 40)
    tab.page.wait_for_function(f"scrollY > {scrolled}")  # the wheel scrolls the page
    tab.page.evaluate(f"scrollTo(0, {scrolled})")
    np.testing.assert_array_equal(tab.picture(), home)
    mouse.move(*middle)
    mouse.down()
    mouse.move(middle[0] + 120, middle[1] + 30, steps=3)
    mouse.up()
    turned = tab.picture()
    assert differing(home, turned) > 0.02
    mouse.wheel(0, -300)  # after the click, the wheel zooms
    zoomed = tab.picture()
    assert differing(turned, zoomed) > 0.02
    assert tab.page.evaluate("scrollY") == scrolled
    tab.canvas.press("Home")
    np.testing.assert_array_equal(tab.picture(), home)
    for key in ("ArrowLeft", "ArrowUp", "+", "-"):
        before = tab.picture()
        tab.canvas.press(key)
        assert differing(before, tab.picture()) > 0.005, key
    time_s = tab.time_s()
    tab.canvas.press(".")
    for _ in range(9):
        tab.canvas.press(".")
    assert tab.time_s() == pytest.approx(time_s + 0.2, abs=0.11)
    tab.canvas.press(" ")
    assert tab.play.inner_text() == "Pause"
    tab.close()
