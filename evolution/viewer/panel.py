"""What a page shows beside the robot: buttons, sliders, how it fares, and plots."""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from viser import GuiApi, GuiSliderHandle, GuiUplotHandle, uplot

from caterpillar_env.drawing.overlay import spring_rgb
from caterpillar_env.robot import Robot
from caterpillar_env.sma import SmaSpring
from caterpillar_env.task import EPISODE_S, Failure
from evolution.viewer.fields import Field, fields_of
from evolution.viewer.session import History, Session

BUTTONS = ("Play", "Pause", "Reset")
FILES = ("Save", "Restore")
_PLOT_HEIGHT_PX = 175
_SPEED = (0.1, 8.0, 0.1)

#: Tells what a page's user wants: the label of a button, or a change of the robot.
OnButton = Callable[[str], None]
OnEdit = Callable[[Callable[[Robot], Robot]], None]


class Panel:
    """Controls and plots of one page. They only tell and are told; nothing is simulated here.

    Args:
        gui: the page's.
        individual: the robot to begin with.
        on_button: called with one of `BUTTONS` or `FILES`, or with "Redraw".
        on_edit: called with a function that makes the changed robot of the present one.
    """

    def __init__(self, gui: GuiApi, individual: Robot, on_button: OnButton, on_edit: OnEdit) -> None:
        self._gui = gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(370)
        self._status = gui.add_markdown("")
        for label, options in (("robot", BUTTONS), ("file", FILES)):
            group = gui.add_button_group(label, options)
            group.on_click(lambda event: on_button(str(event.target.value)))
        lower, upper, step = _SPEED
        self._speed = gui.add_slider("speed", lower, upper, step, 1.0, hint="1 is real time")
        self._follow = gui.add_checkbox("follow", True, hint="the robot stays in view")
        self._follow.on_update(lambda _: on_button("Redraw"))
        self._sliders: list[tuple[Field, GuiSliderHandle[float]]] = []
        for folder, fields in groupby(fields_of(individual), lambda field: field.folder):
            with gui.add_folder(folder or None, expand_by_default=not folder.startswith("segment")):
                for field in fields:
                    self._add_slider(field, individual, on_edit)
        self._add_plots(individual.timed, individual.physics.spring)

    @property
    def speed(self) -> float:
        """Simulated seconds per second."""
        return float(self._speed.value)

    @property
    def follow(self) -> bool:
        """Whether the robot is to stay in view."""
        return bool(self._follow.value)

    def show(self, individual: Robot) -> None:
        """Put the sliders where the robot is."""
        for field, slider in self._sliders:
            slider.value = field.read(individual)  # type: ignore[misc]  # it can be set

    def tell(self, session: Session, *, playing: bool, complaint: str = "") -> None:
        """Say how the robot fares, and draw its plots.

        Args:
            session: the robot.
            playing: whether time passes.
            complaint: why the last change was refused.
        """
        done = session.progress
        self._status.content = (
            f"**{_fate(session, playing=playing)}** at {done.time_s[0]:.1f} s\n\n"
            f"distance **{1000 * done.distance_m[0]:.1f} mm**, "
            f"sideways {1000 * done.lateral_m[0]:.1f} mm, energy {done.energy_j[0]:.1f} J"
            + (f"\n\n**{complaint}**" if complaint else "")
        )
        history: History = session.history
        for plot, values in (
            (self._temperature, history.temperature_c),
            (self._fraction, history.fraction),
            (self._distance, 1000 * history.distance_m[:, None]),
        ):
            plot.data = (history.time_s.copy(), *(column.copy() for column in values.T))

    def _add_slider(self, field: Field, individual: Robot, on_edit: OnEdit) -> None:
        slider = self._gui.add_slider(
            field.label, field.lower, field.upper, field.step, field.read(individual), hint=field.hint
        )
        slider.on_update(lambda _: on_edit(lambda robot: field.write(robot, slider.value)))
        self._sliders.append((field, slider))

    def _add_plots(self, timed: list[str], spring: SmaSpring) -> None:
        panel = self._gui.add_panel()
        panel.dock_left()
        panel.set_width(310)
        with panel.add_tab("Plots"):
            colours = _colours(timed)
            self._gui.add_html(_legend(colours, spring))
            lines = [_line(name, colours[name.split("_")[0]]) for name in timed]
            self._temperature = self._plot("temperature, degC", lines)
            self._fraction = self._plot("austenite fraction", lines, (-0.05, 1.05))
            distance = uplot.Series(label="distance", stroke="#333333", width=2)
            self._distance = self._plot("distance, mm", [distance])

    def _plot(
        self, title: str, lines: list[uplot.Series], bounds: tuple[float, float] | None = None
    ) -> GuiUplotHandle:
        scales: dict[str, uplot.Scale] = {"x": {"time": False, "range": (0.0, EPISODE_S)}}
        if bounds is not None:
            scales["y"] = {"range": bounds}
        empty = tuple(np.zeros(1) for _ in range(1 + len(lines)))
        return self._gui.add_uplot(
            data=empty, series=(uplot.Series(label="s"), *lines), title=title, scales=scales,
            height=_PLOT_HEIGHT_PX, legend=uplot.Legend(show=False), padding=(12, 16, 0, 0),
        )  # fmt: skip


def _fate(session: Session, *, playing: bool) -> str:
    if session.failure is not Failure.NONE:
        return f"Stopped: {session.failure.label}"
    if session.over:
        return "Time is up"
    if playing:
        return "Crawling"
    return "Paused" if session.time_s else "Ready"


def _colours(timed: list[str]) -> dict[str, str]:
    """A colour for each gap."""
    gaps = list(dict.fromkeys(name.split("_")[0] for name in timed))
    last = max(len(gaps) - 1, 1)
    return {gap: to_hex(colormaps["viridis"](0.75 * i / last)) for i, gap in enumerate(gaps)}


def _line(name: str, colour: str) -> uplot.Series:
    line = uplot.Series(label=name.replace("_", " "), stroke=colour, width=1.5)
    if "ventral" in name:
        line["dash"] = (6, 4)
    return line


def _legend(colours: dict[str, str], spring: SmaSpring) -> str:
    """What the lines of the plots are, and the springs' colours in the picture."""
    marks = " ".join(f'<b style="color: {colour}">{gap}</b>' for gap, colour in colours.items())
    points_c = np.array([spring.ambient_c, spring.austenite_start_c, spring.cut_off_c])
    bar = ", ".join(to_hex(rgb) for rgb in spring_rgb(spring, points_c))
    return (
        f'<p style="margin: 0.5em 1em; font-size: 0.85em">{marks}, ventral springs dashed; time in s<br>'
        f"springs {points_c[0]:.0f} "
        f'<span style="display: inline-block; width: 8em; height: 0.7em; '
        f'background: linear-gradient(90deg, {bar})"></span> {points_c[-1]:.0f} degC</p>'
    )
