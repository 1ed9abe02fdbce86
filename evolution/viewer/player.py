"""Lets time pass for the robot of one page, in a thread of its own."""

from __future__ import annotations

import json
import queue
import threading
import time
from collections.abc import Callable

import viser

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Robot
from evolution.viewer.panel import Panel
from evolution.viewer.scene import RobotScene
from evolution.viewer.session import Session

_FRAME_S = 1 / 30
_TELL_S = 0.2  # between two states of the plots
_LONGEST_FRAME_S = 0.25  # after a longer halt time goes on from where it was

Edit = Callable[[Robot], Robot]


class Player:
    """One page: its robot, scene and panel, and the thread that alone touches them.

    Buttons and sliders put orders into a queue; the thread does them between two frames.

    Args:
        page: a client, or a server for all its clients.
        individual: the robot to begin with.
    """

    def __init__(self, page: viser.ClientHandle | viser.ViserServer, individual: Robot) -> None:
        self._page, self._original = page, individual
        self._session = Session(individual)
        self._wanted = individual  # what the sliders say
        self._playing = False
        self._shown_s = 0.0  # simulated time of the frame that is drawn
        self._complaint = ""
        self._told_at_s = 0.0
        self._orders: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        with page.atomic():
            self._scene = RobotScene(page.scene)
            self._panel = Panel(page.gui, individual, self._pressed, self._edited)
            self._rebuild()
        self._thread = threading.Thread(target=self._run, name="caterpillar-page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, and wait for it."""
        self._orders.put(None)
        self._thread.join()

    def _pressed(self, button: str) -> None:
        actions: dict[str, Callable[[], None]] = {
            "Play": self._play, "Pause": self._pause, "Reset": self._reset,
            "Save": self._save, "Restore": self._restore, "Redraw": self._draw,
        }  # fmt: skip
        self._orders.put(actions[button])

    def _edited(self, edit: Edit) -> None:
        self._orders.put(lambda: self._want(edit))

    def _run(self) -> None:
        last_s = time.monotonic()
        while True:
            due_s = max(last_s + _FRAME_S - time.monotonic(), 0.0)
            try:
                order = self._orders.get(timeout=due_s if self._playing else None)
                while True:
                    if order is None:
                        return
                    order()
                    order = self._orders.get_nowait()
            except queue.Empty:
                pass
            # Once for all the steps that a slider was dragged over meanwhile.
            self._change()
            now_s = time.monotonic()
            if self._playing and now_s >= last_s + _FRAME_S:
                self._pass(min(now_s - last_s, _LONGEST_FRAME_S))
                last_s = now_s
            elif not self._playing:
                last_s = now_s

    def _pass(self, elapsed_s: float) -> None:
        session = self._session
        self._shown_s += self._panel.speed * elapsed_s
        while session.time_s < self._shown_s and not session.over:
            session.advance()
        if session.over and session.time_s <= self._shown_s:
            self._shown_s = session.time_s
            self._playing = False
        with self._page.atomic():
            self._draw()
            if not self._playing or time.monotonic() - self._told_at_s > _TELL_S:
                self._tell()

    def _play(self) -> None:
        if self._session.over:
            self._reset()
        self._playing = True
        self._tell()

    def _pause(self) -> None:
        self._playing = False
        self._tell()

    def _reset(self) -> None:
        self._session.reset()
        self._shown_s = 0.0
        with self._page.atomic():
            self._draw()
            self._tell()

    def _restore(self) -> None:
        self._wanted = self._original
        self._panel.show(self._original)

    def _save(self) -> None:
        text = json.dumps(self._session.to_save().to_dict(), indent=2) + "\n"
        self._page.send_file_download("robot.json", text.encode(), save_immediately=True)

    def _want(self, edit: Edit) -> None:
        complaint = ""
        try:
            self._wanted = edit(self._wanted)
        except CaterpillarError as error:
            # Not put right here: it may be half of a number, and the page does so when it is left.
            complaint = str(error)
        if complaint != self._complaint:
            self._complaint = complaint
            self._tell()

    def _change(self) -> None:
        if self._wanted is self._session.individual:
            return
        if self._session.change(self._wanted):
            self._shown_s = 0.0
            with self._page.atomic():
                self._rebuild()
        self._tell()

    def _rebuild(self) -> None:
        self._scene.build(self._session.individual)
        self._draw()
        self._tell()

    def _draw(self) -> None:
        self._scene.draw(*self._session.pose(self._shown_s), follow=self._panel.follow)

    def _tell(self) -> None:
        self._told_at_s = time.monotonic()
        self._panel.tell(self._session, playing=self._playing, complaint=self._complaint)
