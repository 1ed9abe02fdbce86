"""Pictures of robots that crawl, for both environments."""

from __future__ import annotations

from typing import Any

import numpy as np

from caterpillar_env.drawing.overlay import Readout
from caterpillar_env.drawing.rendering import RobotRenderer, View
from caterpillar_env.morphology import Body
from caterpillar_env.task import Crawl


class Pictures:
    """Draws the rows of a `Crawl` as they are; what draws one is made when it is first needed.

    Args:
        crawl: the robots.
        view: size and camera.
        overlay: whether to write time, distance and energy on colour pictures, and draw the path.
    """

    def __init__(self, crawl: Crawl, view: View, *, overlay: bool) -> None:
        self._crawl, self._view, self._overlay = crawl, view, overlay
        self._renderers: dict[int, tuple[Body, RobotRenderer]] = {}

    def draw(self, row: int, mode: str) -> Any:
        """One row; modes, results and errors are those of `RobotRenderer.draw`."""
        simulation = self._crawl.simulation
        body, renderer = self._renderers.get(row, (None, None))
        if renderer is None or body != simulation.body(row):
            if renderer is not None:
                renderer.close()
            model, data = simulation.drawable(row)
            renderer = RobotRenderer(model, data, simulation.physics.spring, self._view)
            self._renderers[row] = simulation.body(row), renderer
        alone = np.array([row])
        readout = Readout.of(self._crawl.progress(alone)) if self._overlay else None
        (temperature_c,) = simulation.state(alone).temperature_c
        return renderer.draw(simulation.qpos(row), temperature_c, mode, readout)

    def restart(self, row: int) -> None:
        """Begin the path anew: another episode."""
        if row in self._renderers:
            self._renderers[row][1].forget_path()

    def close(self) -> None:
        """Free windows and drawing contexts."""
        for _, renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()
