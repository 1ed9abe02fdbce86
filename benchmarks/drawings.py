"""Drawings of the model with the paper's symbols, after Figs 6 to 10 of Saunders 2009.

All lengths are those of the nominal body. `python -m benchmarks.gallery` writes the drawings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, Ellipse

from caterpillar_env.arrays import Array
from caterpillar_env.drawing.rendering import RobotRenderer, View
from caterpillar_env.model import ELEMENTS_PER_SEGMENT, FOOT_RADIUS_M
from caterpillar_env.morphology import Morphology, length_m
from caterpillar_env.physics import Physics

Point = tuple[float, float]

_BODY = Morphology()
# The symbols of the paper, in mm.
W, L, R = (1000 * _BODY.leg_separation_m, 1000 * _BODY.segment_length_m, 1000 * _BODY.segment_radius_m)
X, Y, Z = (1000 * _BODY.attachment_x_m, 1000 * _BODY.attachment_y_m, 1000 * _BODY.attachment_z_m)
AXIS = 2 * R  # height of the axis and of the centre of mass
FOOT = 1000 * FOOT_RADIUS_M
_INK, _FORCE, _SPRING, _SIZE = "#222222", "#c1121f", "#2a6fdb", "#666666"
_HEAD, _LEGGED, _PLAIN = "#f5e6a3", "#cfe8bf", "#b4d3a4"
_MISSING = {"Date": None, "Creator": None}


def write_drawings(folder: Path) -> None:
    """Write one file per figure into a folder: the picture of the robot as WebP, the others as SVG."""
    robot().savefig(folder / "fig6-robot.webp", pil_kwargs={"quality": 80})
    drawings: dict[str, Callable[[], Figure]] = {
        "fig7-elements": elements, "fig8-parameters": parameters, "fig9-roll": roll, "eq5-yaw": yaw,
        "fig10-lift": lift,
    }  # fmt: skip
    for name, draw in drawings.items():
        with rc_context({"svg.hashsalt": name}):
            draw().savefig(folder / f"{name}.svg", metadata=_MISSING)


def robot() -> Figure:
    """Draw the robot, with the names of its parts (Fig. 6)."""
    physics, view = Physics(), View(900, 420)
    renderer = RobotRenderer(_BODY, physics, view, view_length_m=0.6 * length_m(_BODY, 4))
    pixels = renderer.draw(renderer.model.qpos0, np.full(physics.num_springs, physics.spring.ambient_c))
    model, data = renderer.model, mujoco.MjData(renderer.model)
    renderer.close()
    mujoco.mj_forward(model, data)
    camera = model.camera(view.camera_name).id
    focal = view.height / 2 / math.tan(math.radians(model.cam_fovy[camera]) / 2)

    def pixel(point_m: Array) -> tuple[float, float]:
        right, up, back = data.cam_xmat[camera].reshape(3, 3).T @ (point_m - data.cam_xpos[camera])
        return view.width / 2 - focal * right / back, view.height / 2 + focal * up / back

    figure = Figure(figsize=(9.0, 4.2))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(pixels)
    axes.set_axis_off()
    top, anchor = np.array([0, 0, R / 1000]), data.site("anchor1_rear_dorsal_left").xpos
    spring = (
        data.site("anchor0_front_dorsal_right").xpos + 2 * data.site("anchor1_rear_dorsal_right").xpos
    ) / 3
    for text, point, place in (
        ("head", data.body("element0").xpos + top, (780, 60)),
        ("legged element", data.body("element2").xpos + top, (560, 30)),
        ("plain element", data.body("element3").xpos + top, (370, 30)),
        ("attachment of a spring", anchor, (170, 60)),
        ("SMA spring", spring, (800, 330)),
        ("foot", data.geom("foot1_right").xpos, (560, 390)),
        ("leg", (data.geom("foot2_right").xpos + data.body("element4").xpos) / 2, (250, 390)),
    ):  # fmt: skip
        axes.annotate(
            text, pixel(point), place, ha="center", va="center", fontsize=12,
            bbox={"boxstyle": "round", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
            arrowprops={"arrowstyle": "-", "color": _INK},
        )  # fmt: skip
    return figure


def elements() -> Figure:
    """Draw the eight elements and their joints from the side (Fig. 7)."""
    figure, axes = _start((9.0, 4.2), (-3.85 * L, L / 2 + 16), (-3, AXIS + R + 12))
    for segment in range(Physics().num_segments):
        front = -segment * L
        _segment(axes, front, head=segment == 0)
        for number, at in enumerate((front, front - L / 2), start=ELEMENTS_PER_SEGMENT * segment + 1):
            axes.text(at, AXIS + 2, str(number), ha="center", fontsize=12)
        axes.text(front - L / 4, AXIS + R + 6, f"segment {segment + 1}", ha="center")
        axes.plot([front + L / 4 - 1, front - 3 * L / 4 + 1], [AXIS + R + 4] * 2, color=_SIZE, lw=1)
        (inside,) = axes.plot(front - L / 4, AXIS, "s", ms=9, mfc="white", mec=_INK)
        if segment:
            (neck,) = axes.plot(front + L / 4, AXIS, "o", ms=10, mfc="white", mec=_FORCE, mew=2)
            shift = 0.6 * (-1) ** segment  # so that the ends of two springs do not overlap
            for height in (AXIS + Y + shift, AXIS - Y + shift):
                ends = front + L + X, front - X
                (spring,) = axes.plot(ends, [height] * 2, "o-", color=_SPRING, lw=2, ms=3, zorder=1)
    _ground(axes, -3.8 * L, L / 2)
    axes.annotate("", (L / 2 + 15, AXIS), (L / 2, AXIS), arrowprops={"arrowstyle": "->"})
    axes.text(L / 2 + 7, AXIS + 2, "forward", ha="center")
    figure.legend(
        [neck, inside, spring],
        [
            "neck: revolute joint (pitch) with a torsional, viscoelastic moment",
            "inside a segment: prismatic joint and revolute joint (yaw)",
            "two dorsal and two ventral SMA springs, one behind the other",
        ],
        loc="outside lower center", frameon=False,
    )  # fmt: skip
    return figure


def parameters() -> Figure:
    """Draw the parameters of the body from the side and from the front (Fig. 8)."""
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    side, front = figure.subplots(1, 2, width_ratios=[86, 38])
    height = (-9, AXIS + R + 10)
    _prepare(side, (-1.75 * L - 8, L / 2 + 15), height)
    _prepare(front, (-R - 6, R + 12), height)
    side.set_title("side", fontsize="medium")
    front.set_title("front", fontsize="medium")
    _segment(side, 0)
    _segment(side, -L)
    for sign in (1, -1):
        side.plot([X, -L - X], [AXIS + sign * Y] * 2, "o-", color=_SPRING, lw=2, ms=4)
    _measure(side, (0, -5), (-L, -5), "$L$", below=True, drop=FOOT)
    _measure(side, (0, AXIS + R + 3), (X, AXIS + R + 3), "$x$", drop=AXIS + Y)
    _measure(side, (L / 4 + 5, AXIS), (L / 4 + 5, AXIS + Y), "$y$", lead=X)
    _measure(side, (-1.75 * L - 4, AXIS), (-1.75 * L - 4, AXIS + R), "$R$", lead=-1.5 * L, right=False)
    _measure(side, (L / 4 + 15, 0), (L / 4 + 15, AXIS), "$2R$", lead=0)
    side.plot([-1.75 * L, L / 4 + 15], [AXIS] * 2, color=_SIZE, lw=0.7, ls="-.")
    side.text(-0.9 * L, AXIS + R + 3, "mass $m$ per segment", ha="center")
    _ground(side, -1.8 * L, L / 2 + 12)
    _front(front)
    for sign, up in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        front.plot(sign * Z, AXIS + up * Y, "o", color=_SPRING, ms=5)
    front.plot([0, 0], [AXIS - R - 2, AXIS + R + 4], color=_SIZE, lw=0.7, ls="-.")
    front.plot([-R - 2, R + 6], [AXIS] * 2, color=_SIZE, lw=0.7, ls="-.")
    _measure(front, (-W / 2, -5), (W / 2, -5), "$w$", below=True, drop=FOOT)
    _measure(front, (0, AXIS + R + 3), (Z, AXIS + R + 3), "$z$", drop=AXIS + Y)
    _measure(front, (R + 5, AXIS), (R + 5, AXIS + Y), "$y$", lead=Z)
    _ground(front, -R - 6, R + 10)
    return figure


def roll() -> Figure:
    """Draw the forces on a segment that rolls about a foot, from the front (Fig. 9)."""
    figure, axes = _start((5.0, 4.6), (-R - 12, R + 16), (-9, AXIS + R + 6))
    _front(axes)
    _cm(axes, (0, AXIS))
    _force(axes, (0, AXIS), (17, 0), r"$F_\phi$")
    _force(axes, (0, AXIS), (0, -14), "$W$", side=-1)
    axes.plot(W / 2, 0, "o", color=_INK, ms=5)
    axes.text(W / 2 + 3, 1, "$a$", fontsize=12)
    axes.plot([W / 2, 0], [0, AXIS], color=_SIZE, lw=1, ls="--")
    axes.text(0.4, 4, r"$r_{a,cm}$")
    axes.add_patch(Arc((0, AXIS), 2 * R + 6, 2 * R + 6, theta1=42, theta2=75, color=_INK))
    x, y = (R + 3) * math.cos(0.7), AXIS + (R + 3) * math.sin(0.7)
    arrow = {"arrowstyle": "->", "color": _INK, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (x, y), (x - 0.7, y + 0.8), arrowprops=arrow)
    axes.text(x + 1, y + 1, r"$\phi$", fontsize=12)
    _measure(axes, (0, -5), (W / 2, -5), "$w/2$", below=True, drop=0)
    _measure(axes, (-R - 6, 0), (-R - 6, AXIS), "$2R$", lead=0, right=False)
    _ground(axes, -R - 9, R + 12)
    axes.set_title(
        r"roll: $M_a = r_{a,cm} \times (F_\phi + W) = 0$"
        "\n" r"$F_\phi = m g P_w / 2,\quad P_w = w / 2R$", fontsize="medium",
    )  # fmt: skip
    return figure


def yaw() -> Figure:
    """Draw the forces on a segment that turns about a foot, from above (eq. 5)."""
    figure, axes = _start((5.0, 3.0), (-33, 29), (-R - 3, R + 3))
    axes.add_patch(Ellipse((0, 0), L / 2, 2 * R, fc=_LEGGED, ec=_INK, alpha=0.7))
    pivot, other = (0, W / 2), (0, -W / 2)
    axes.plot([0, 0], [pivot[1], other[1]], color=_INK, lw=2)
    for foot in (pivot, other):
        axes.add_patch(Circle(foot, FOOT, fc=_INK))
    axes.text(5, W / 2 + 2, "pivot: the foot that stays", va="center", fontsize=9)
    axes.plot(0, -Z, "o", color=_SPRING, ms=6, zorder=7)
    _force(axes, (0, -Z), (20, 0), r"$F_\psi$")
    _force(axes, other, (-13, 0), r"$\mu m g / 2$", side=-1, shift=-3.5)
    _measure(axes, (-17, -Z), (-17, W / 2), r"$w/2 + z$", lead=0, right=False)
    _measure(axes, (-30, -W / 2), (-30, W / 2), "$w$", lead=0, right=False)
    _measure(axes, (12, -Z), (12, 0), "$z$", lead=0)
    axes.plot([-10, 28], [0, 0], color=_SIZE, lw=0.7, ls="-.")
    axes.annotate("", (28, 3), (17, 3), arrowprops={"arrowstyle": "->"})
    axes.text(22, 4, "forward", ha="center")
    axes.set_title(
        r"yaw: $F_\psi\,(w/2 + z) = \mu\,(m g / 2)\,w$" "\n" r"$F_\psi = \mu m g w / (2z + w)$",
        fontsize="medium",
    )
    return figure


def lift() -> Figure:
    """Draw the forces on a segment that a spring lifts about b, from the side (Fig. 10)."""
    figure, axes = _start((7.2, 4.8), (-L - 4, 1.5 * L), (-9, AXIS + R + 12))
    theta = 0.35
    cosine, sine = math.cos(theta), math.sin(theta)

    def turned(along: float, up: float) -> tuple[float, float]:
        """Rotate a point of the segment about b, the origin."""
        return along * cosine - up * sine, along * sine + up * cosine

    for place, angle in ((turned, math.degrees(theta)), (lambda x, y: (x, y), 0.0)):
        centre = place(L / 2 if angle else -L / 2, AXIS)
        axes.add_patch(Ellipse(centre, L / 2, 2 * R, angle=angle, fc=_LEGGED, ec=_INK, alpha=0.7))
        foot = place(L / 2 if angle else -L / 2, FOOT)
        axes.plot(*zip(centre, foot, strict=True), color=_INK, lw=2)
        axes.add_patch(Circle(foot, FOOT, fc=_INK))
    cm, point, fixed = turned(L / 2, AXIS), turned(L / 2 + X, AXIS + Y), (-L / 2 - X, AXIS + Y)
    axes.plot(*zip(point, fixed, strict=True), color=_SPRING, lw=2, zorder=1)
    axes.text(-L / 2, AXIS + Y + 7, r"spring: $k$, rest length $\Delta$", color=_SPRING, ha="center")
    for at in (point, fixed):
        axes.plot(*at, "o", color=_SPRING, ms=6)
    pull = np.subtract(fixed, point)
    _force(axes, point, 17 * pull / np.linalg.norm(pull), "$F_s$", up=True)
    _cm(axes, cm)
    _force(axes, cm, (0, -14), "$W$")
    axes.text(point[0] + 2, point[1] + 1, "sp")
    axes.plot(0, 0, "o", color=_INK, ms=6)
    axes.text(-3, -5, "$b$", fontsize=12)
    for end, text, share in ((cm, r"$r_{b,cm}$", 0.35), (point, r"$r_{b,sp}$", 0.62)):
        axes.plot([0, end[0]], [0, end[1]], color=_SIZE, lw=1, ls="--")
        axes.text(share * end[0] - 5.5, share * end[1] + 1, text)
    axes.plot(*zip((0, 0), turned(1.1 * L, 0), strict=True), color=_SIZE, lw=1)
    axes.add_patch(Arc((0, 0), 44, 44, theta1=0, theta2=math.degrees(theta), color=_INK))
    axes.text(23, 3, r"$\theta$", fontsize=12)
    _measure(axes, turned(0, -3), turned(L / 2, -3), "$L/2$", below=True)
    _measure(axes, turned(L / 2, AXIS + R + 3), turned(L / 2 + X, AXIS + R + 3), "$x$")
    ahead = 3 / 4 * L + 5
    foot, middle, above = (turned(ahead, up) for up in (0.0, AXIS, AXIS + Y))
    _measure(axes, foot, middle, "$h_b = 2R$")
    _measure(axes, middle, above, "$y$")
    _ground(axes, -L - 6, 1.6 * L)
    axes.set_title(
        r"lift: $M_b = r_{b,sp} \times F_s + r_{b,cm} \times W$"
        "\n" r"at $\theta = 0$:  $M_b = k\,(L + 2x - \Delta)(y + h_b) - m g L / 2$", fontsize="medium",
    )  # fmt: skip
    return figure


def _start(size_in: tuple[float, float], x: Point, y: Point) -> tuple[Figure, Axes]:
    """Return a figure and its axes, which show the ranges x and y, mm."""
    figure = Figure(figsize=size_in, layout="constrained")
    axes = figure.subplots()
    _prepare(axes, x, y)
    return figure, axes


def _prepare(axes: Axes, x: Point, y: Point) -> None:
    axes.set(aspect="equal", xlim=x, ylim=y)
    axes.set_axis_off()


def _segment(axes: Axes, front: float, *, head: bool = False) -> None:
    """Draw the two elements of a segment from the side; the legged element is at x = `front`."""
    for at, colour in ((front, _HEAD if head else _LEGGED), (front - L / 2, _PLAIN)):
        axes.add_patch(Ellipse((at, AXIS), L / 2, 2 * R, fc=colour, ec=_INK, alpha=0.7))
    axes.plot([front, front], [AXIS, FOOT], color=_INK, lw=2, zorder=1)
    axes.add_patch(Circle((front, FOOT), FOOT, fc=_INK))


def _front(axes: Axes) -> None:
    """Draw a legged element from the front."""
    axes.add_patch(Circle((0, AXIS), R, fc=_LEGGED, ec=_INK, alpha=0.7))
    for sign in (1, -1):
        axes.plot([sign * 0.3 * W, sign * W / 2], [AXIS, FOOT], color=_INK, lw=2)
        axes.add_patch(Circle((sign * W / 2, FOOT), FOOT, fc=_INK))


def _ground(axes: Axes, left: float, right: float) -> None:
    axes.plot([left, right], [0, 0], color=_INK, lw=1)
    axes.fill_between([left, right], -1.5, 0, hatch="////", fc="none", ec=_SIZE, lw=0)


def _cm(axes: Axes, at: Point) -> None:
    axes.plot(*at, "o", ms=9, mfc="white", mec=_INK, zorder=5)
    axes.plot(*at, "+", ms=9, color=_INK, zorder=5)
    axes.text(at[0] - 1.5, at[1] + 2, "cm", ha="right")


def _force(
    axes: Axes, at: Point, vector: Point | Array, text: str, *, side: int = 1, up: bool = False,
    shift: float = 0.0,
) -> None:  # fmt: skip
    """Draw a force at a point. `side` puts the text right (1) or left (-1) of the tip, `up` above it."""
    tip = (at[0] + vector[0], at[1] + vector[1])
    axes.annotate(
        "", tip, at, zorder=6,
        arrowprops={"arrowstyle": "-|>", "color": _FORCE, "lw": 2, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    place, align = ((tip[0], tip[1] + 2), "center") if up else ((tip[0] + side, tip[1] + shift), "left")
    axes.text(*place, text, color=_FORCE, fontsize=12, va="center", ha="right" if side < 0 else align)


def _measure(
    axes: Axes, start: Point, end: Point, text: str, *, below: bool = False, right: bool = True,
    lead: float | None = None, drop: float | None = None,
) -> None:  # fmt: skip
    """Draw a dimension between two points.

    Args:
        axes: where to draw.
        start: one end, mm.
        end: the other end, mm.
        text: symbol of the dimension.
        below: whether the text is below a horizontal dimension.
        right: whether the text is on the right of a vertical one.
        lead: x from which auxiliary lines lead to the ends of a vertical dimension.
        drop: z from which auxiliary lines lead to the ends of a horizontal one.
    """
    for point in (start, end):
        if lead is not None:
            axes.plot([lead, point[0]], [point[1]] * 2, color=_SIZE, lw=0.7)
        if drop is not None:
            axes.plot([point[0]] * 2, [drop, point[1]], color=_SIZE, lw=0.7)
    style = {"arrowstyle": "<->", "color": _SIZE, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8}
    axes.annotate("", end, start, arrowprops=style)
    x, y = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
    if abs(end[0] - start[0]) > abs(end[1] - start[1]):
        axes.text(x, y - 1 if below else y + 1, text, ha="center", va="top" if below else "bottom")
    else:
        axes.text(x + 1 if right else x - 1, y, text, ha="left" if right else "right", va="center")
