"""Make the pictures of docs/gallery.md.

`python -m benchmarks.gallery` writes them to `docs/images/gallery`, from the robots in
`results/search` and the policies in `results/rl-ablation`. It takes a few minutes, most of them for the
films.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import polars
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.drawings import write_drawings
from caterpillar_env.arrays import Array
from caterpillar_env.drawing.overlay import spring_rgb
from caterpillar_env.drawing.rendering import RobotRenderer, View
from caterpillar_env.drawing.scenery import Camera
from caterpillar_env.drawing.video import Recording, VideoConfig, write_video
from caterpillar_env.gait import GaitTimings, pair_names
from caterpillar_env.ground import FOOT
from caterpillar_env.model import ELEMENTS_PER_SEGMENT
from caterpillar_env.morphology import LOWER, NAMES, UPPER, Morphology, length_m
from caterpillar_env.physics import GRAVITY_M_S2, SMA_STEP_S, Physics
from caterpillar_env.robot import Robot, wave_robot
from caterpillar_env.sma import SmaSpring
from caterpillar_env.task import EPISODE_S, Crawl, Failure
from caterpillar_env.validation.robots import random_robots

ROOT = Path(__file__).parents[1]
STUDY = ROOT / "results" / "search"
TRAINING = ROOT / "results" / "rl-ablation"
POLICIES = {"ppo-timing": "PPO, times", "ppo-switch": "PPO, switches", "ppo-codesign": "PPO, co-design"}
OUT = ROOT / "docs" / "images" / "gallery"
ARM = "ga-uniform"  # arm of the study whose failed robots are shown
STILLS = 5  #: pictures of a gait period
WAVE_START_S = 15.0  # start of the gait period that the figure of the wave shows
#: The study has no robots that jumped or diverged. With much stronger springs, robots diverge if the
#: integrator is implicitfast. With the default integrator, they jump if these springs are heated in a
#: fraction of a second.
_SPRING = SmaSpring(austenite_stiffness_n_m=1000.0, force_limit_n=20.0)
UNSTABLE = Physics(spring=_SPRING, integrator="implicitfast", timestep_s=0.01)
STRONG = Physics(spring=replace(_SPRING, drive_current_a=3.0))


class Shot(NamedTuple):
    """How to film a failure."""

    failure: Failure
    speed: float  #: simulated seconds per second
    camera: Camera
    physics: Physics | None = None  #: physics of random robots; None: film a robot of the study


SHOTS = (
    Shot(Failure.FLIPPED, 1.0, "track"), Shot(Failure.TIPPED, 0.5, "track"),
    Shot(Failure.JUMPED, 0.4, "side", STRONG), Shot(Failure.VEERED, 10.0, "top"),
    Shot(Failure.SAGGED, 2.0, "side"), Shot(Failure.DIVERGED, 0.05, "track", UNSTABLE),
)  # fmt: skip


def write_films(folder: Path, single: tuple[int, int], six: tuple[int, int]) -> None:
    """Film the best robot of the study, and the best, the middle and the worst winner of each arm."""
    recordings = []
    for arm in ("shade", ARM):
        winners = [Robot.load(path) for path in (STUDY / "winners" / arm).glob("seed-*.json")]
        winners.sort(key=lambda robot: -(robot.fitness_m or 0.0))
        count = len(winners)
        for place in (1, count // 2, count):
            recordings.append(Recording(winners[place - 1], f"{arm}, {place} of {count}"))
    best = Recording(recordings[0].robot)
    write_video([best], folder / "winner.webp", VideoConfig(4.0, *single))
    write_video(recordings, folder / "winners.webp", VideoConfig(6.0, *six, "side"))


def write_policies(folder: Path, size: tuple[int, int]) -> None:
    """Film the hand-made wave and three policies, which need the extra `rl`."""
    from baselines.policy import TrainedRobot

    recordings = [Recording(wave_robot(), "hand-made wave")]
    for arm, name in POLICIES.items():
        recordings.append(Recording(TrainedRobot.load(TRAINING / "winners" / f"{arm}.json"), name))
    write_video(recordings, folder / "policies.webp", VideoConfig(6.0, *size, "side"))


def write_failures(folder: Path, size: tuple[int, int]) -> None:
    """Film one robot for each kind of failure."""
    for shot in SHOTS:
        name, config = shot.failure.label, VideoConfig(shot.speed, *size, shot.camera)
        write_video([Recording(find_failing(shot), name)], folder / f"{name}.webp", config)


def find_failing(shot: Shot) -> Robot:
    """Return a robot that fails in the given way.

    Raises:
        LookupError: no candidate fails in this way.
    """
    if shot.physics is None:
        candidates: Iterable[Robot] = failed_in_study(shot.failure)
        duration_s = EPISODE_S
    else:
        candidates, duration_s = random_robots(100, 0, shot.physics), 3.0
    for robot in candidates:
        if robot.simulate(threads=1, duration_s=duration_s).failure[0] == shot.failure:
            return robot
    raise LookupError(f"no robot is {shot.failure.label}")


def failed_in_study(failure: Failure) -> Iterator[Robot]:
    """Yield robots of the study that failed in the given way, the earliest failures first."""
    table = polars.read_parquet(STUDY / "evaluations.parquet")
    found = table.filter(arm=ARM, failure=failure.label).sort("simulated_s", "seed", "evaluation")
    for row in found.iter_rows(named=True):
        winner = Robot.load(STUDY / "winners" / ARM / f"seed-{row['seed']}.json")  # for its physics
        body = np.clip([row[name] for name in NAMES], LOWER, UPPER)  # the table has float32
        pairs, period_s = pair_names(winner.physics.num_segments), winner.timings.period_s
        on_s, off_s = (
            np.clip([row[f"{pair}_{edge}_s"] for pair in pairs], 0, period_s) for edge in ("on", "off")
        )
        yield Robot(Morphology(*body.tolist()), GaitTimings(period_s, on_s, off_s), winner.physics)


class Period(NamedTuple):
    """One gait period of a robot, with K thermal steps."""

    qpos: Array  #: generalized positions, (K, nq)
    temperature_c: Array  #: temperature of each pair of springs, (K, pairs)
    power: Array  #: share of the drive power of each pair, (K, pairs)
    load_n: Array  #: vertical load on the feet of each segment, (K, segments)
    advance_m: Array  #: advance of the centre of mass, (K,)


def measure_period(robot: Robot) -> Period:
    """Simulate a robot in a plain MuJoCo loop that reads the load of every foot.

    The period begins at `WAVE_START_S`. The robot must have mirrored timings.
    """
    physics, period_s = robot.physics, robot.timings.period_s
    crawl = Crawl([robot.morphology], physics, threads=1)
    power = robot.power()
    periods = round(WAVE_START_S / period_s) + 1
    heating = crawl.simulation.heat(np.tile(power[None], (1, periods, 1)))
    model = crawl.simulation.models[0]
    data = mujoco.MjData(model)
    segment_of = {
        geom: model.geom_bodyid[geom] // ELEMENTS_PER_SEGMENT
        for geom in np.flatnonzero(model.geom_conaffinity == FOOT)
    }
    steps, substeps = len(power), round(SMA_STEP_S / physics.timestep_s)
    first = (periods - 1) * steps * substeps
    qpos = np.empty((steps, model.nq))
    load_n, x_m = np.zeros((steps, physics.num_segments)), np.empty(steps)
    for number, control in enumerate(heating.control[0]):
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
        if number < first:
            continue
        step = (number - first) // substeps
        qpos[step], x_m[step] = data.qpos, data.subtree_com[1, 0]
        for contact in data.contact:
            if contact.efc_address >= 0 and contact.geom[1] in segment_of:
                load_n[step, segment_of[contact.geom[1]]] += data.efc_force[contact.efc_address]
    springs = heating.springs.path.rows((slice(-steps, None), 0))
    celsius = springs.temperature_c(physics.spring)
    pairs = celsius.reshape(steps, -1, 2).mean(axis=2)  # the left and the right spring are equal
    return Period(qpos, pairs, power[:, ::2], load_n / substeps, x_m - x_m[0])


def draw_wave(robot: Robot) -> Figure:
    """Draw a gait period: pictures, temperatures, loads of the feet, and advance."""
    period, physics = measure_period(robot), robot.physics
    span_s = robot.timings.period_s
    figure = Figure(figsize=(9.0, 8.4), layout="constrained")
    grid = figure.add_gridspec(4, STILLS, height_ratios=[0.9, 1.7, 1.2, 1.0])
    view = View(360, 270, "side")
    near_m = 0.75 * length_m(robot.morphology, physics.num_segments)
    renderer = RobotRenderer(robot.morphology, physics, view, view_length_m=near_m)
    times_s = (np.arange(STILLS) + 0.5) * span_s / STILLS
    for column, time_s in enumerate(times_s):
        step = round(time_s / SMA_STEP_S)
        axes = figure.add_subplot(grid[0, column])
        celsius = period.temperature_c[step].repeat(2)
        axes.imshow(renderer.draw(period.qpos[step], celsius))
        axes.set_title(f"{time_s:.1f} s", fontsize="medium")
        axes.set_axis_off()
    renderer.close()
    heat = figure.add_subplot(grid[1, :])
    pairs = pair_names(physics.num_segments)
    order = [*range(0, len(pairs), 2), *range(1, len(pairs), 2)]  # dorsal above ventral
    colours = np.stack([spring_rgb(physics.spring, period.temperature_c[:, pair]) for pair in order])
    _show_rows(heat, colours, [pairs[pair].replace("_", " ") for pair in order], span_s)
    for row, pair in enumerate(order):
        seconds = np.arange(len(period.power)) * SMA_STEP_S
        on = np.where(period.power[:, pair] > 0, row - 0.44, np.nan)
        heat.plot(seconds, on, color="black", lw=3, solid_capstyle="butt")
    heat.set_title("Temperature of the springs, left and right alike. Black: power on", loc="left")
    feet = figure.add_subplot(grid[2, :])
    weight_n = GRAVITY_M_S2 * robot.morphology.segment_mass_kg * physics.num_segments  # type: ignore[union-attr]
    image = feet.imshow(
        100 * period.load_n.T / weight_n, aspect="auto", cmap="Oranges", vmin=0, vmax=100,
        extent=(0, span_s, physics.num_segments - 0.5, -0.5), interpolation="nearest",
    )  # fmt: skip
    labels = [f"segment {n + 1}" for n in range(physics.num_segments)]
    labels[0] += " (head)"
    feet.set_yticks(range(physics.num_segments), labels)
    feet.set_title("Load on the feet of a segment", loc="left")
    figure.colorbar(image, ax=feet, label="% of the weight")
    path = figure.add_subplot(grid[3, :])
    path.plot(np.arange(len(period.advance_m)) * SMA_STEP_S, 1000 * period.advance_m)
    path.set(xlabel="time in the gait period (s)", ylabel="mm", xlim=(0, span_s))
    path.set_title("Advance of the centre of mass", loc="left")
    path.grid(alpha=0.3)
    for axes in (heat, feet, path):
        for time_s in times_s:
            axes.axvline(time_s, color="black", lw=0.8, ls=":")
        axes.title.set_fontsize("medium")
    return figure


def _show_rows(axes: Axes, colours: Array, labels: list[str], span_s: float) -> None:
    """Show one row of colours for each label, (rows, K, 3)."""
    extent = (0, span_s, len(labels) - 0.5, -0.5)
    axes.imshow(colours, aspect="auto", extent=extent, interpolation="nearest")
    axes.set_yticks(range(len(labels)), labels)
    for row in range(1, len(labels)):
        axes.axhline(row - 0.5, color="white", lw=2)


def main() -> None:
    """Write all pictures, or those of the given kinds."""
    kinds = ("films", "policies", "failures", "wave", "drawings")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"{', '.join(kinds)}; all by default")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for the pictures")
    parser.add_argument("--scale", type=float, default=1.0, help="factor on the size of the films")
    args = parser.parse_args()
    if unknown := set(args.kinds) - set(kinds):
        parser.error(f"unknown kind {', '.join(sorted(unknown))}; choose from {', '.join(kinds)}")
    chosen = args.kinds or kinds
    args.out.mkdir(parents=True, exist_ok=True)

    def size(width: int, height: int) -> tuple[int, int]:
        return 2 * round(args.scale * width / 2), 2 * round(args.scale * height / 2)

    if "films" in chosen:
        write_films(args.out, size(448, 280), size(720, 320))
    if "policies" in chosen:
        write_policies(args.out, size(500, 280))
    if "failures" in chosen:
        write_failures(args.out, size(288, 200))
    if "wave" in chosen:
        winner = Robot.load(STUDY / "winners" / "shade.json")
        draw_wave(winner).savefig(args.out / "wave.png", dpi=90)
    if "drawings" in chosen:
        write_drawings(args.out)


if __name__ == "__main__":
    main()
