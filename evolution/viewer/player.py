"""Thread that runs the robot of one page."""

from __future__ import annotations

import json
import queue
import threading
import time
from collections.abc import Callable

import viser

from caterpillar_env.robot import Robot
from evolution.viewer.panel import Panel
from evolution.viewer.scene import RobotScene
from evolution.viewer.session import Session

_FRAME_S = 1 / 30
_PANEL_S = 0.2  # time between two updates of text and plots
_LONGEST_FRAME_S = 0.25  # after a longer interruption the robot does not catch up with real time


class Player:
    """Robot, scene and panel of one page. A single thread changes them.

    Buttons and sliders put functions into a queue. The thread calls them between two frames.

    Args:
        page: a client, or a server for all its clients.
        robot: the initial robot.

    Attributes:
        session: the simulation.
        panel: controls and plots.
    """

    def __init__(self, page: viser.ClientHandle | viser.ViserServer, robot: Robot) -> None:
        self.session = Session(robot)
        self._page, self._original = page, robot
        self._playing = False
        self._shown_s = 0.0  # simulated time of the displayed pose
        self._panel_updated_s = 0.0
        self._queue: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._closing = threading.Event()
        with page.atomic():
            self._scene = RobotScene(page.scene)
            self.panel = Panel(
                page.gui,
                robot,
                on_button=lambda button: self._queue.put(lambda: self._press(button)),
                on_edit=lambda edit: self._queue.put(lambda: self._change(edit(self.session.robot))),
            )
            self._show(panel=True)
        self._thread = threading.Thread(target=self._run, name="caterpillar-page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop the thread and wait for it."""
        self._closing.set()
        self._thread.join()

    def _run(self) -> None:
        last_s = time.monotonic()
        while not self._closing.wait(_FRAME_S):
            now_s = time.monotonic()
            handled = not self._queue.empty()
            while not self._queue.empty():
                self._queue.get()()
            if self._playing:
                self._advance(min(now_s - last_s, _LONGEST_FRAME_S))
                handled |= not self._playing
            if handled or self._playing:
                self._show(panel=handled or now_s - self._panel_updated_s > _PANEL_S)
            last_s = now_s

    def _advance(self, elapsed_s: float) -> None:
        session = self.session
        self._shown_s += self.panel.speed.value * elapsed_s
        while session.time_s < self._shown_s and not session.finished:
            session.advance()
        if session.finished and session.time_s <= self._shown_s:
            self._shown_s = session.time_s
            self._playing = False

    def _show(self, *, panel: bool) -> None:
        """Draw the robot. Update the panel too if `panel` is true."""
        with self._page.atomic():
            qpos, temperature_c = self.session.pose(self._shown_s)
            follow = self.panel.follow.value
            self._scene.draw(self.session.robot, qpos, temperature_c, follow=follow)
            if panel:
                self._panel_updated_s = time.monotonic()
                self.panel.update(self.session, playing=self._playing)

    def _press(self, button: str) -> None:
        if button == "Reset" or (button == "Play" and self.session.finished):
            self.session.reset()
            self._shown_s = 0.0
        if button in ("Play", "Pause"):
            self._playing = button == "Play"
        elif button == "Restore":
            self.panel.set_sliders(self._original)
            self._change(self._original)
        elif button == "Save":
            text = json.dumps(self.session.result().to_dict(), indent=2) + "\n"
            self._page.send_file_download("robot.json", text.encode(), save_immediately=True)

    def _change(self, robot: Robot) -> None:
        if robot is not self.session.robot and self.session.change(robot):
            self._shown_s = 0.0
