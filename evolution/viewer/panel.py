"""Controls and plots beside the robot."""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from viser import GuiApi, GuiSliderHandle, GuiUplotHandle, uplot

from caterpillar_env.drawing.overlay import spring_rgb
from caterpillar_env.morphology import PARAMETERS
from caterpillar_env.robot import Robot
from caterpillar_env.sma import SmaSpring
from caterpillar_env.task import EPISODE_S, Failure
from evolution.viewer.fields import Field, fields_of
from evolution.viewer.session import Session

_HINTS = {p.name: f"{p.description} ({p.symbol} in the paper); restarts the robot" for p in PARAMETERS}
_HINTS["friction"] = "friction of feet and elements on the ground; restarts the robot"
_TIME_HINT = "if off is earlier than on, the power stays on beyond the end of the period"

#: Function that returns a changed copy of a robot.
Edit = Callable[[Robot], Robot]


class Panel:
    """Controls and plots of one page.

    Args:
        gui: GUI of the page.
        robot: the initial robot.
        on_button: called with the label of a button: "Play", "Pause", "Reset", "Save", "Restore", or
            "Follow" for the checkbox.
        on_edit: called with the edit that a slider makes.

    Attributes:
        status: text about the robot.
        speed: simulated seconds per second.
        follow: whether the robot stays in view.
        temperature: plot of temperatures in °C, with one line per spring or pair that the gait controls.
        fraction: plot of the austenite fractions of the same springs or pairs.
        distance: plot of the distance in mm.
    """

    def __init__(
        self,
        gui: GuiApi,
        robot: Robot,
        on_button: Callable[[str], None],
        on_edit: Callable[[Edit], None],
    ) -> None:
        self._gui = gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(370)
        self.status = gui.add_markdown("")
        for label, options in (("robot", ("Play", "Pause", "Reset")), ("file", ("Save", "Restore"))):
            buttons = gui.add_button_group(label, options)
            buttons.on_click(lambda event: on_button(str(event.target.value)))
        self.speed = gui.add_slider("speed", 0.1, 8.0, 0.1, 1.0, hint="1 is real time")
        self.follow = gui.add_checkbox("follow", True, hint="keep the robot in view")
        self.follow.on_update(lambda _: on_button("Follow"))
        self._sliders: list[tuple[Field, GuiSliderHandle[float]]] = []
        for folder, fields in groupby(fields_of(robot), lambda field: field.folder):
            with gui.add_folder(folder or None, expand_by_default=not folder.startswith("segment")):
                for field in fields:
                    self._add_slider(field, robot, on_edit)
        self._add_plots(robot.timed, robot.physics.spring)

    def set_sliders(self, robot: Robot) -> None:
        """Set the sliders to the values of a robot."""
        for field, slider in self._sliders:
            slider.value = field.read(robot)  # type: ignore[misc]  # viser lets it be set

    def update(self, session: Session, *, playing: bool) -> None:
        """Update text and plots. `playing` tells whether the simulation is running."""
        progress = session.progress
        self.status.content = (
            f"**{_state(session, playing=playing)}** at {progress.time_s[0]:.1f} s\n\n"
            f"distance **{1000 * progress.distance_m[0]:.1f} mm**, "
            f"sideways {1000 * progress.lateral_m[0]:.1f} mm, energy {progress.energy_j[0]:.1f} J"
        )
        time_s, distance_m, temperature_c, fraction = session.measurements()
        self.temperature.data = (time_s, *np.ascontiguousarray(temperature_c.T))
        self.fraction.data = (time_s, *np.ascontiguousarray(fraction.T))
        self.distance.data = (time_s, 1000 * distance_m)

    def _add_slider(self, field: Field, robot: Robot, on_edit: Callable[[Edit], None]) -> None:
        gene, (lower, upper), step = field.gene, field.bounds, 10.0**-field.decimals
        label = f"{gene.title}, {gene.shown[1]}".removesuffix(", ")
        hint = _HINTS.get(gene.name, _TIME_HINT)
        slider = self._gui.add_slider(label, lower, upper, step, field.read(robot), hint=hint)
        slider.on_update(lambda _: on_edit(lambda robot: field.write(robot, slider.value)))
        self._sliders.append((field, slider))

    def _add_plots(self, timed: list[str], spring: SmaSpring) -> None:
        gaps = list(dict.fromkeys(name.split("_")[0] for name in timed))
        shades = 0.75 * np.arange(len(gaps)) / max(len(gaps) - 1, 1)
        colours = dict(zip(gaps, map(to_hex, colormaps["viridis"](shades)), strict=True))
        panel = self._gui.add_panel()
        panel.dock_left()
        panel.set_width(310)
        with panel.add_tab("Plots"):
            self._gui.add_html(_legend(colours, spring))
            lines = [_line(name, colours[name.split("_")[0]]) for name in timed]
            distance = uplot.Series(label="distance", stroke="#333333", width=2)
            self.temperature = self._plot("temperature, °C", lines)
            self.fraction = self._plot("austenite fraction", lines, (-0.05, 1.05))
            self.distance = self._plot("distance, mm", [distance])

    def _plot(
        self, title: str, lines: list[uplot.Series], bounds: tuple[float, float] | None = None
    ) -> GuiUplotHandle:
        scales: dict[str, uplot.Scale] = {"x": {"time": False, "range": (0.0, EPISODE_S)}}
        if bounds is not None:
            scales["y"] = {"range": bounds}
        empty = tuple(np.zeros(1) for _ in range(1 + len(lines)))
        return self._gui.add_uplot(
            data=empty, series=(uplot.Series(label="s"), *lines), title=title, scales=scales,
            height=175, legend=uplot.Legend(show=False), padding=(12, 16, 0, 0),
        )  # fmt: skip


def _state(session: Session, *, playing: bool) -> str:
    if session.failure is not Failure.NONE:
        return f"Failed: {session.failure.label}"
    if session.finished:
        return "Finished"
    if playing:
        return "Crawling"
    return "Paused" if session.time_s else "Ready"


def _line(name: str, colour: str) -> uplot.Series:
    line = uplot.Series(label=name.replace("_", " "), stroke=colour, width=1.5)
    if "ventral" in name:
        line["dash"] = (6, 4)
    return line


def _legend(colours: dict[str, str], spring: SmaSpring) -> str:
    """Return HTML that explains the plot lines and the spring colours."""
    gaps = " ".join(f'<b style="color: {colour}">{gap}</b>' for gap, colour in colours.items())
    points_c = np.array([spring.ambient_c, spring.austenite_start_c, spring.cut_off_c])
    gradient = ", ".join(to_hex(rgb) for rgb in spring_rgb(spring, points_c))
    return (
        f'<p style="margin: 0.5em 1em; font-size: 0.85em">{gaps}, ventral springs dashed; time in s<br>'
        f"springs {points_c[0]:.0f} "
        f'<span style="display: inline-block; width: 8em; height: 0.7em; '
        f'background: linear-gradient(90deg, {gradient})"></span> {points_c[-1]:.0f} °C</p>'
    )
