"""`CaterpillarSMA-v0` and `CaterpillarSMASwitch-v0`: the class docstring is the specification."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from caterpillar_env.drawing.backend import has_display
from caterpillar_env.drawing.rendering import Pictures, View
from caterpillar_env.episodes import Episodes, check_options
from caterpillar_env.errors import SimulationError
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import CONTROL_INTERVAL_S
from caterpillar_env.simulation import Trace

_ROW = np.array([0])


class CaterpillarEnv(gymnasium.Env[NDArray[np.float32], NDArray[Any]], EzPickle):
    """
    ## Description
    A soft, caterpillar-like robot (Saunders, Rieffel and Rife 2009) lies on flat ground. It has
    N segments (4 by default) of two rigid elements each, a pair of passive legs on every segment, and
    4 (N - 1) springs of shape-memory alloy (SMA) between the segments: two dorsal and two ventral ones in
    every gap, left and right. A spring that is powered heats up, turns to austenite, pulls harder, and
    goes slack again as it cools. The task is to travel straight ahead, along x, in 30 s.

    ## Action space
    `action_mode="timing"` (`CaterpillarSMA-v0`): one step is one gait period. The action is a
    `Box(-1, 1, (4 (N - 1),), float32)`: on and off time of each left-right pair in turn, -1 the start and
    1 the end of the period. A pair is powered from on to off, round the end when off < on.

    | index | meaning (N = 4) | unit at -1 / 1 |
    |---|---|---|
    | 0, 1 | on, off of the dorsal pair of gap 1 (behind the head) | 0 s / `gait_period_s` |
    | 2, 3 | on, off of the ventral pair of gap 1 | same |
    | 4-7 | the same for gap 2 | same |
    | 8-11 | the same for gap 3 | same |

    With `symmetric=False` every spring has its own times, `Box(-1, 1, (8 (N - 1),))`, in the order dorsal
    left, dorsal right, ventral left, ventral right of each gap.

    `action_mode="switch"` (`CaterpillarSMASwitch-v0`): one step is `frame_skip` control intervals of 0.1 s.
    The action is `MultiBinary(4 (N - 1))`, power on or off per spring in the order above.

    ## Observation space
    A `Box(-1000, 1000, (n,), float32)` of values around one; n = 66 in timing mode and 68 in switch mode for N = 4.
    `env.unwrapped.observation_names` lists all entries in order. Horizontal vectors are in the frame of
    the body's own heading. With J = 3N - 1 internal joints and S = 4 (N - 1) springs:

    | entries | what | scale of 1 |
    |---|---|---|
    | J | joint positions from head to tail: axial, bend, then neck, axial, bend of each further segment | 3 mm, 0.3 rad |
    | J | their velocities | 20 mm/s, 1 rad/s |
    | 3 | mean upward axis of the elements | 1 |
    | 2 | cosine and sine of the heading relative to the start | 1 |
    | 1 | height of the centre of mass | 24 mm |
    | 3 | mean velocity of the elements | 20 mm/s |
    | 3 | mean angular velocity of the elements | 1 rad/s |
    | S | temperature of the springs, 0 at ambient | cut-off (120 degC) |
    | S | austenite fraction | 1 |
    | 2 | cosine and sine of the phase in the gait period (switch mode only; else it is constant) | 1 |
    | 8 | morphology, -1 at the lower and 1 at the upper bound | |

    Axes, height and velocities of the body, and the distances in `info`, are those at the start of the last
    physics step (2.5 ms ago), as in Gymnasium's own MuJoCo environments.

    ## Rewards
    *reward* = *reward_forward* + *reward_ctrl* + *reward_failure*
    - *reward_forward*: `forward_reward_weight` (100 per metre) times the progress of the centre of mass of
      the whole robot along its starting heading. The return of an episode without failure is the distance
      in centimetres.
    - *reward_ctrl*: minus `ctrl_cost_weight` (0) times the electrical energy of the step in joule.
    - *reward_failure*: minus `failure_cost` (5) once, in the step in which the robot fails.

    ## Starting state
    Straight, at rest, feet on the ground, springs at ambient temperature. With `reset_noise_scale` s each
    hinge is off by U(-s, s) rad and each axial joint by U(-s, s) cm.

    ## Domain randomisation
    `randomization={"friction": (0.5, 1.1), "mass": (0.9, 1.1)}`, say, draws conditions anew at each reset, one draw
    for every row, from the episode's seed; uniformly between two bounds:

    | key | what | otherwise |
    |---|---|---|
    | `friction` | of feet and elements on the ground | `physics.friction` |
    | `mismatch_std` | spread of the springs' strengths, all of which are drawn anew | `physics.strengths()` |
    | `spring_force` | factor on the force of all springs | 1 |
    | `mass` | factor on the mass of the body | 1 |
    | `ambient_c` | temperature of the air, degC; observed temperatures stay relative to `physics.spring.ambient_c` | `physics.spring.ambient_c` |

    `info` then holds `friction`, `spring_strengths` (one factor a spring, mismatch and `spring_force`
    together), `mass` and `ambient_c`.

    ## Episode end
    - Termination: the robot *flipped* (mean upward axis inclined by more than 120 degrees), *tipped* (more
      than 60 degrees), *jumped* (lowest point more than 5 mm above the ground), *veered* (heading off by
      more than 45 degrees or centre of mass more than 120 mm off the starting line), *sagged* (the body
      instead of the feet carries more than 5 % of the load, on average over at least 30 s), or *diverged*
      (the integration broke down). Judged every 0.1 s, within a step too. `info["failure"]` names the
      failure, "ok" if none. With `terminate_on_failure=False` only a divergence ends the episode.
    - Truncation: after `episode_s` (30) simulated seconds.

    ## Info
    `x_position`, `y_position` (of the centre of mass, world frame), `distance` (m, along the starting
    heading), `distance_from_origin`, `x_velocity`, `y_velocity` (mean over the step), `reward_forward`,
    `reward_ctrl`, `reward_failure` (steps only), `energy_j` (since reset), `body_load` (share of the
    load on the body, mean over at least 30 s), `time_s`, `failure`; with domain randomisation also what
    was drawn.

    ## Arguments
    | parameter | default | description |
    |---|---|---|
    | `action_mode` | by id | "timing" or "switch" |
    | `symmetric` | `True` | timing mode: pairs or single springs |
    | `morphology` | nominal | the body: mapping of the eight parameters, eight numbers, or a `Morphology` |
    | `physics` | `{}` | mapping of fields of `Physics` that differ from its defaults; `{"num_segments": 6}`, say |
    | `gait_period_s` | 5.0 | a whole number of 0.1 s |
    | `frame_skip` | 1 | control intervals of 0.1 s (switch mode) or gait periods (timing mode) in a step |
    | `episode_s` | 30.0 | simulated length of an episode |
    | `forward_reward_weight`, `ctrl_cost_weight`, `failure_cost` | 100, 0, 5 | see Rewards |
    | `reset_noise_scale` | 0.0 | see Starting state |
    | `randomization` | `None` | see Domain randomisation |
    | `terminate_on_failure` | `True` | see Episode end |
    | `threads` | 1 | threads of the vector environment; 0 for all cores |
    | `render_mode` | `None` | "human", "rgb_array", "depth_array" or "rgb_array_list" |
    | `width`, `height` | 640, 480 | size of pictures, pixels |
    | `camera_name` | "track" | "track", "side" or "top"; all follow the robot |
    | `default_camera_config` | `None` | attributes of a free camera instead |
    | `overlay` | `False` | write time, distance, energy and a legend on colour pictures, and draw the path |

    Springs are coloured by temperature, feet that touch the ground are orange, squares of the ground are 2 cm, and
    the ruler reads the distance. "depth_array" holds metres along the view. Where a machine cannot draw, there is one
    warning, and `render` returns None; all else works.

    `reset(options={"morphology": ...})` changes the body; it stays until it is replaced.
    In "rgb_array_list" mode a frame is drawn every control interval, so that a gait period can be watched.

    ## Version history
    - v0: first version (MuJoCo 4.0).
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["human", "rgb_array", "depth_array", "rgb_array_list"],
        "render_fps": round(1 / CONTROL_INTERVAL_S),
    }

    def __init__(
        self,
        *,
        morphology: Morphology | Mapping[str, float] | Any = None,
        threads: int = 1,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        camera_name: str = "track",
        default_camera_config: dict[str, Any] | None = None,
        overlay: bool = False,
        **episodes: Any,
    ) -> None:
        arguments = {k: v for k, v in locals().items() if k not in ("self", "__class__", "episodes")}
        modes = [m for m in self.metadata["render_modes"] if m != "human" or has_display()]
        if render_mode is not None and render_mode not in modes:
            raise SimulationError(
                f"render_mode must be None or one of {', '.join(modes)}; got {render_mode!r}"
                + ('. "human" needs a display, and DISPLAY is not set' if len(modes) < 4 else "")
            )
        EzPickle.__init__(self, **arguments, **episodes)
        body = Morphology() if morphology is None else Morphology.of(morphology)
        self._episodes = Episodes([body], threads=threads, **episodes)
        self.action_space = self._episodes.action_space
        self.observation_space = self._episodes.observation_space
        self.render_mode = render_mode
        view = View(width, height, camera_name, default_camera_config)
        self.crawl = self._episodes.crawl
        self._pictures = Pictures(self.crawl, view, overlay=overlay)
        self._frames: list[Any] = []
        self._running = False
        fps = self.metadata["render_fps"]
        if render_mode in ("rgb_array", "depth_array"):
            fps = 1 / self._episodes.step_s  # a frame is a step
        self.metadata = {**self.metadata, "render_modes": modes, "render_fps": fps}

    @property
    def dt(self) -> float:
        """Simulated length of a step, s."""
        return self._episodes.step_s

    @property
    def morphology(self) -> Morphology:
        """The robot's body; `reset` may change it."""
        return self._episodes.morphology(0)

    @property
    def observation_names(self) -> list[str]:
        """Name of every entry of the observation, in order."""
        return self._episodes.observation_names

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode; `options={"morphology": ...}` changes the body from now on."""
        super().reset(seed=seed)
        chosen = check_options(options, ("morphology",))
        bodies = [Morphology.of(chosen["morphology"])] if "morphology" in chosen else None
        observation, info = self._episodes.reset(_ROW, [self.np_random], bodies)
        self._running = True
        self._frames = []
        self._pictures.restart(0)
        self._draw_live()
        return observation[0], _first(info)

    def step(
        self, action: NDArray[Any]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Advance by one gait period (timing) or `frame_skip` control intervals (switch)."""
        if not self._running:
            raise SimulationError("call reset() before step()")
        live = self.render_mode in ("human", "rgb_array_list")
        actions = self._episodes.checked([action], 1)
        step = self._episodes.step(actions, _ROW, self._on_interval if live else None)
        return (
            step.observation[0],
            float(step.reward[0]),
            bool(step.terminated[0]),
            bool(step.truncated[0]),
            _first(step.info),
        )

    def render(self) -> Any:
        """The picture of the current state, or in "rgb_array_list" mode those since the last call."""
        if self.render_mode is None:
            gymnasium.logger.warn(
                'render() draws nothing without a render mode: make(..., render_mode="rgb_array")'
            )
            return None
        if self.render_mode == "rgb_array_list":
            frames, self._frames = self._frames, []
            return frames
        return self._draw(self.render_mode)

    def close(self) -> None:
        """Free the window or the drawing context."""
        self._pictures.close()

    def _on_interval(self, trace: Trace | None) -> None:
        self._draw_live()

    def _draw_live(self) -> None:
        if self.render_mode == "human":
            self._draw("human")
        elif self.render_mode == "rgb_array_list":
            frame = self._draw("rgb_array")
            self._frames += [] if frame is None else [frame]

    def _draw(self, mode: str) -> Any:
        if not self._running:
            raise SimulationError("call reset() before render()")
        return self._pictures.draw(0, mode)


def _first(info: dict[str, NDArray[Any]]) -> dict[str, Any]:
    return {key: value.item() for key, value in info.items()}
