"""The page of one browser tab: its robot, its controls, and the thread that runs both."""

from __future__ import annotations

import json
import queue
import threading
import time
from collections.abc import Callable
from itertools import groupby

import numpy as np
import viser
from matplotlib.colors import to_hex

from caterpillar_env.drawing.overlay import spring_rgb
from caterpillar_env.morphology import PARAMETERS
from caterpillar_env.robot import Robot
from caterpillar_env.sma import SmaSpring
from caterpillar_env.task import Failure
from evolution.genome import Timing
from evolution.viewer.fields import Field, fields_of
from evolution.viewer.scene import RobotScene
from evolution.viewer.session import Session

_FRAME_S = 1 / 30
_LONGEST_FRAME_S = 0.25  # after a longer interruption the robot does not catch up with real time
_HINTS = {p.name: f"{p.description} ({p.symbol} in the paper); restarts the robot" for p in PARAMETERS}
_HINTS["friction"] = "friction of feet and elements on the ground; restarts the robot"
_PHASE_HINT = (
    "share of the period; delays count from the dorsal pair of the gap ahead (dorsal pairs) or of the "
    "same gap (ventral pairs)"
)
_TIME_HINT = "if off is earlier than on, the power stays on beyond the end of the period"


class Page:
    """Robot, scene and controls of one page. A single thread changes them.

    Buttons and sliders put functions into a queue. The thread calls them between two frames.
    """

    def __init__(
        self, client: viser.ClientHandle | viser.ViserServer, robot: Robot, timing: Timing
    ) -> None:
        self.session = Session(robot)
        self._fields = fields_of(robot, timing)
        self._client = client
        self._playing = False
        self._shown_s = 0.0  # simulated time of the displayed pose
        self._queue: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._closing = threading.Event()
        with client.atomic():
            self._scene = RobotScene(client.scene)
            self._add_controls(robot)
            self._show()
        self._thread = threading.Thread(target=self._run, name="caterpillar-page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop the thread and wait for it."""
        self._closing.set()
        self._thread.join()

    def _add_controls(self, robot: Robot) -> None:
        gui = self._client.gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(370)
        self.status = gui.add_html("")
        buttons = gui.add_button_group("robot", ("Play", "Pause", "Reset", "Save"))
        buttons.on_click(lambda event: self._queue.put(lambda: self._press(str(event.target.value))))
        self._speed = gui.add_slider("speed", 0.1, 8.0, 0.1, 1.0, hint="1 is real time")
        gui.add_html(_legend(robot.physics.spring))
        for folder, fields in groupby(self._fields, lambda field: field.folder):
            with gui.add_folder(folder or None, expand_by_default=not folder.startswith("segment")):
                for field in fields:
                    self._add_slider(field, robot)

    def _add_slider(self, field: Field, robot: Robot) -> None:
        gene, (lower, upper), step = field.gene, field.bounds, 10.0**-field.decimals
        label = f"{gene.title}, {gene.shown[1]}".removesuffix(", ")
        hint = _HINTS.get(gene.name, _TIME_HINT if gene.unit == "s" else _PHASE_HINT)
        slider = self._client.gui.add_slider(label, lower, upper, step, field.read(robot), hint=hint)
        slider.on_update(lambda _: self._queue.put(lambda: self._change(field, slider.value)))

    def _run(self) -> None:
        last_s = time.monotonic()
        while not self._closing.wait(_FRAME_S):
            now_s = time.monotonic()
            changed = self._playing or not self._queue.empty()
            while not self._queue.empty():
                self._queue.get()()
            if self._playing:
                self._advance(min(now_s - last_s, _LONGEST_FRAME_S))
            if changed:
                self._show()
            last_s = now_s

    def _advance(self, elapsed_s: float) -> None:
        session = self.session
        deadline_s = time.monotonic() + _LONGEST_FRAME_S
        due_s = self._shown_s + self._speed.value * elapsed_s
        while session.time_s < due_s and not session.finished and time.monotonic() < deadline_s:
            session.advance()
        self._shown_s = min(due_s, session.time_s)  # a slow machine falls behind
        if session.finished and self._shown_s == session.time_s:
            self._playing = False

    def _show(self) -> None:
        progress = self.session.progress
        with self._client.atomic():
            self._scene.draw(self.session.robot, *self.session.pose(self._shown_s))
            self.status.content = (
                f'<p style="margin: 0.5em 1em"><b>{self._state()}</b> at {progress.time_s[0]:.1f} s<br>'
                f"distance <b>{1000 * progress.distance_m[0]:.1f} mm</b>, "
                f"sideways {1000 * progress.lateral_m[0]:.1f} mm, "
                f"energy {progress.energy_j[0]:.1f} J</p>"
            )

    def _state(self) -> str:
        if self.session.failure is not Failure.NONE:
            return f"Failed: {self.session.failure.label}"
        if self.session.finished:
            return "Finished"
        if self._playing:
            return "Crawling"
        return "Paused" if self.session.time_s else "Ready"

    def _press(self, button: str) -> None:
        if button == "Save":
            text = json.dumps(self.session.robot.to_dict(), indent=2) + "\n"
            self._client.send_file_download("robot.json", text.encode(), save_immediately=True)
            return
        if button == "Reset" or (button == "Play" and self.session.finished):
            self.session.reset()
            self._shown_s = 0.0
        if button != "Reset":
            self._playing = button == "Play"

    def _change(self, field: Field, value: float) -> None:
        if self.session.change(field.write(self.session.robot, value)):
            self._shown_s = 0.0


def _legend(spring: SmaSpring) -> str:
    """Return HTML that explains the colours of the springs."""
    points_c = np.linspace(spring.ambient_c, spring.cut_off_c, 33)
    gradient = ", ".join(to_hex(rgb) for rgb in spring_rgb(spring, points_c))
    return (
        f'<p style="margin: 0.5em 1em; font-size: 0.85em">springs {points_c[0]:.0f} '
        f'<span style="display: inline-block; width: 8em; height: 0.7em; '
        f'background: linear-gradient(90deg, {gradient})"></span> {points_c[-1]:.0f} °C</p>'
    )
