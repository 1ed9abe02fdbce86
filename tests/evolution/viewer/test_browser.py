"""The page in headless Chromium: clicks, pictures and two tabs."""

import io
import json
import threading
import time
from urllib.parse import urlparse

import numpy as np
import pytest
from PIL import Image

from caterpillar_env.robot import Robot, wave_robot

pytest.importorskip("viser")

from evolution.viewer.server import Viewer

TIMEOUT_MS = 120_000  # software rendering on a busy machine
SMALL = {"width": 1024, "height": 500}  # faster to draw
SLIDER_ROW = "xpath=ancestor::div[contains(@class, 'Flex-root')][1]"

pytestmark = [
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection:UserWarning"),
    pytest.mark.slow,
]


@pytest.fixture(scope="module")
def viewer():
    with Viewer(wave_robot(), 0) as viewer:
        yield viewer


class Tab:
    """One browser tab."""

    def __init__(self, browser, url, **kwargs):
        self.page = browser.new_page(**kwargs)
        self.page.set_default_timeout(TIMEOUT_MS)
        self.requests = []
        self.errors = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        note = self.page.locator("#webgl-software-rendering button")
        self.page.add_locator_handler(note, lambda note: note.click())
        self.page.goto(url)
        self.page.get_by_text("Ready").wait_for()

    def press(self, button):
        self.page.get_by_role("button", name=button, exact=True).click()

    def distance_mm(self):
        status = self.page.get_by_text("sideways").inner_text()
        return float(status.split("distance")[1].split("mm")[0])

    def slider(self, label):
        row = self.page.locator("label", has_text=label).locator(SLIDER_ROW)
        return row.locator("input[inputmode=decimal]")

    def picture(self):
        """The part of the window beside the panel."""
        clip = {"x": 130, "y": 100, "width": 500, "height": 300}
        return np.asarray(Image.open(io.BytesIO(self.page.screenshot(clip=clip))).convert("RGB"))

    def wait(self, condition):
        end_s = time.monotonic() + TIMEOUT_MS / 1000
        while not condition():
            assert time.monotonic() < end_s
            self.page.wait_for_timeout(100)


def page_threads():
    return [t for t in threading.enumerate() if t.name == "caterpillar-page"]


def greenish(picture):
    """Share of the pixels that show the robot's shells."""
    red, green, blue = picture.astype(int).transpose(2, 0, 1)
    return float(((green > red + 8) & (green > blue + 20)).mean())


def test_play_moves_the_robot_and_nothing_is_loaded_from_other_hosts(browser, viewer):
    tab = Tab(browser, viewer.url, viewport=SMALL)
    tab.wait(lambda: greenish(tab.picture()) > 0.01)
    before = tab.picture()
    assert tab.distance_mm() == 0
    tab.press("Play")
    tab.wait(lambda: tab.distance_mm() > 10)
    after = tab.picture()
    assert greenish(after) > 0.01  # it is still in view
    assert (np.abs(before.astype(int) - after).max(axis=2) > 30).mean() > 0.005
    tab.press("Pause")
    tab.page.get_by_text("Paused").wait_for()
    tab.press("Reset")
    tab.page.get_by_text("Ready").wait_for()
    assert tab.distance_mm() == 0
    assert tab.requests
    assert {urlparse(url.removeprefix("blob:")).hostname for url in tab.requests} == {"127.0.0.1"}
    assert tab.errors == []
    tab.page.close()


def test_every_tab_has_its_own_robot_and_closing_it_ends_its_thread(browser, viewer):
    first, second = (Tab(browser, viewer.url, viewport=SMALL) for _ in range(2))
    assert len(page_threads()) == 2
    first.slider("segment radius").fill("13.5")
    first.press("Play")
    first.wait(lambda: first.distance_mm() != 0)
    assert second.distance_mm() == 0
    assert second.slider("segment radius").input_value() == "12"
    assert second.page.get_by_text("Ready").is_visible()
    first.page.close()
    second.wait(lambda: len(page_threads()) == 1)
    second.press("Play")
    second.wait(lambda: second.distance_mm() != 0)
    second.page.close()
    end_s = time.monotonic() + 60
    while page_threads() and time.monotonic() < end_s:
        time.sleep(0.1)
    assert not page_threads()


def test_typed_numbers_stay_within_their_bounds_and_the_robot_can_be_saved(browser, viewer, tmp_path):
    tab = Tab(browser, viewer.url, viewport=SMALL)
    box = tab.slider("segment radius")
    for typed, kept in (("99", "15"), ("-3", "9"), ("11.26", "11.2"), ("1e9", None), ("12.5", "12.5")):
        box.fill("")
        box.press_sequentially(typed)
        box.press("Enter")
        box.blur()
        if kept is not None:
            tab.wait(lambda kept=kept: box.input_value() == kept)
        assert 9 <= float(box.input_value()) <= 15
    with tab.page.expect_download() as download:
        tab.press("Save")
    download.value.save_as(tmp_path / "robot.json")
    robot = Robot.load(tmp_path / "robot.json")
    assert robot.morphology.segment_radius_m == 0.0125
    assert robot.timings.on_s.tolist() == wave_robot().timings.on_s.tolist()
    assert json.loads((tmp_path / "robot.json").read_text())["fitness_m"] is None
    tab.page.close()
