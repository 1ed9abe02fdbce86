"""Effects of the buttons and sliders of one page on its robot, without a browser."""

import json
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot

pytest.importorskip("viser")

from evolution.viewer.page import Page

ROBOT = Robot(
    Morphology(segment_length_m=0.0312345),
    GaitTimings(2.0, np.array([0.0, 1.0]), np.array([0.6, 1.5])),
    Physics(num_segments=2, timestep_s=0.01),
    fitness_m=0.01,
)


class Hand:
    """Operates the controls of a page and reads its status."""

    def __init__(self, client, page):
        handles = client.gui._gui_input_handle_from_uuid.values()
        self.widgets = {handle.label: handle for handle in handles}
        self.page = page

    def press(self, button):
        self.widgets["robot"].value = button

    @property
    def robot(self):
        return self.page.session.robot

    @property
    def status(self):
        return self.page.status.content

    def wait(self, condition):
        end_s = time.monotonic() + 20
        while not condition():
            assert time.monotonic() < end_s, self.status
            time.sleep(0.01)

    def wait_for(self, text):
        self.wait(lambda: text in self.status)


@pytest.fixture
def hand(client):
    page = Page(client, ROBOT, "on-off")
    yield Hand(client, page)
    page.close()


def test_play_pause_and_reset(hand):
    hand.wait_for("Ready")
    hand.press("Play")
    hand.wait_for("Crawling")
    hand.wait(lambda: hand.page.session.time_s > 0.3)
    hand.press("Pause")
    hand.wait_for("Paused")
    at_s = hand.page.session.time_s
    time.sleep(0.2)
    assert hand.page.session.time_s == at_s
    hand.press("Reset")
    hand.wait_for("Ready")
    assert hand.page.session.time_s == 0


def test_the_speed_slider_sets_the_simulated_seconds_per_second(hand):
    hand.page.close()  # stops the thread, so that the test tells the time
    shown_s = []
    for speed in (0.1, 2.0):
        hand.widgets["speed"].value = speed
        hand.page._advance(0.2)
        shown_s.append(hand.page._shown_s)
    assert shown_s == pytest.approx([0.1 * 0.2, 0.1 * 0.2 + 2.0 * 0.2])


def test_a_crawling_robot_does_not_catch_up_after_an_interruption(hand, monkeypatch):
    elapsed_s = []
    monkeypatch.setattr(hand.page, "_advance", elapsed_s.append)
    hand.press("Play")
    hand.wait_for("Crawling")
    hand.page._queue.put(lambda: time.sleep(0.5))
    count = len(elapsed_s)
    hand.wait(lambda: len(elapsed_s) > count + 3)
    assert max(elapsed_s) == 0.25


@pytest.mark.slow
def test_a_finished_robot_stops_and_can_be_saved(hand, client, monkeypatch):
    sent = {}
    monkeypatch.setattr(client, "send_file_download", lambda name, data, **_: sent.update({name: data}))
    hand.widgets["speed"].value = 8.0
    hand.press("Play")
    hand.wait_for("Finished")
    outcomes = ROBOT.simulate(threads=1)
    aside_mm = 1000 * hand.page.session.progress.lateral_m[0]
    assert (
        f"distance <b>{1000 * outcomes.distance_m[0]:.1f} mm</b>, sideways {aside_mm:.1f} mm"
        in hand.status
    )
    assert f"energy {outcomes.energy_j[0]:.1f} J" in hand.status
    hand.press("Save")
    hand.wait(lambda: sent)
    assert Robot.from_dict(json.loads(sent["robot.json"])).digest == ROBOT.digest
    hand.press("Play")  # restarts
    hand.wait_for("Crawling")


def test_a_slider_changes_one_parameter(hand):
    hand.widgets["segment radius, mm"].value = 13.0
    hand.wait(lambda: hand.robot is not ROBOT)
    expected = replace(ROBOT.morphology, segment_radius_m=0.013)
    assert hand.robot.morphology == expected  # the length keeps its exact value
    hand.widgets["friction"].value = 0.5
    hand.wait(lambda: hand.robot.physics.friction == 0.5)
    hand.widgets["gap1 ventral off, s"].value = 1.8
    hand.wait(lambda: hand.robot.timings.off_s.tolist() == [0.6, 1.8])


def test_a_new_body_restarts_the_robot_without_pausing_it(hand):
    hand.press("Play")
    hand.wait(lambda: hand.page.session.time_s > 0.3)
    hand.widgets["segment radius, mm"].value = 13.0
    hand.wait(lambda: hand.robot is not ROBOT)
    hand.wait_for("Crawling")
    hand.wait(lambda: hand.page.session.time_s > 0)


def test_closing_ends_the_thread_of_a_crawling_robot(client):
    before = set(threading.enumerate())
    page = Page(client, ROBOT, "on-off")
    (thread,) = set(threading.enumerate()) - before
    Hand(client, page).press("Play")
    end_s = time.monotonic() + 20
    while page.session.time_s < 0.2 and time.monotonic() < end_s:
        time.sleep(0.01)
    assert page.session.time_s >= 0.2
    page.close()
    assert not thread.is_alive()
