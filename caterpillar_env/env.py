"""The Gymnasium environments `CaterpillarSMA-v0` and `CaterpillarSMASwitch-v0`."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from caterpillar_env.arguments import ActionMode, EpisodeConfig, check_options, check_render_mode
from caterpillar_env.drawing.rendering import Pictures, View
from caterpillar_env.drawing.scenery import Camera
from caterpillar_env.episodes import Episodes, EpisodeState, WithSpec, make_generator
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.faults import Faults
from caterpillar_env.gait import GAIT_PERIOD_S
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import CONTROL_INTERVAL_S, Physics
from caterpillar_env.randomization import Randomization
from caterpillar_env.task import EPISODE_S, Failure, OnInterval
from caterpillar_env.worlds import World

if TYPE_CHECKING:
    import mujoco

_ROW = np.array([0])


class CaterpillarEnv(WithSpec, gymnasium.Env[NDArray[np.float32], NDArray[Any]], EzPickle):
    """A soft caterpillar robot whose task is to crawl straight ahead for 30 s.

    Registered as `CaterpillarSMA-v0` (timing mode) and `CaterpillarSMASwitch-v0` (switch mode). The page
    `docs/environment.md` specifies actions, observations, rewards, failures and `info`.

    Args:
        morphology: the body: a mapping of the parameters that differ from the nominal body, the eight
            values of `morphology.NAMES`, or a `Morphology`.
        physics: a mapping of the fields that differ from the defaults of `Physics`, or a `Physics`.
        world: ground to crawl on, such as "rough" or "slope:angle_deg=5", see `World.of`. It replaces
            `physics.world`.
        action_mode: "timing", where a step is a gait period and the action holds on and off times;
            "phase", the same with delays and duties; or "switch", where a step is a control interval of
            0.1 s and the action switches springs.
        symmetric: in timing and phase mode, whether the left and the right spring of a pair are powered
            together.
        gait_period_s: gait period, s, a multiple of 0.1 s.
        action_repeat: number of gait periods, or of control intervals in switch mode, in a step.
        episode_s: simulated length of an episode, s, a multiple of 0.1 s.
        forward_reward_weight: reward for a metre of progress.
        ctrl_cost_weight: cost of a joule of electrical energy.
        failure_cost: cost of a failure.
        reset_noise_scale: at reset, hinges are displaced by up to this many rad and axial joints by up
            to this many cm, but not beyond their limits.
        goal_heading_rad: direction to crawl in, counter-clockwise from the direction in which the head
            points at reset, from -0.7 to 0.7 rad. Distances, rewards and the heading in the observation
            refer to it.
        randomization: ranges of the conditions to sample at each reset: a mapping from fields of
            `Randomization` to lower and upper bounds.
        faults: number of springs that fail in each episode, or a mapping of fields of `Faults`.
        terminate_on_failure: whether a failure ends the episode. A divergence always does.
        render_mode: None or "rgb_array". With pygame, `gymnasium.make` also accepts "human" (a window).
        width: width of the frames, pixels.
        height: height of the frames, pixels.
        camera_name: "track", "side" or "top"; all of them follow the robot.

    Attributes:
        dt: simulated length of an environment step, s.
        frame_skip: number of physics steps in an environment step.
        observation_names: name of every entry of the observation, in order.
        config: settings of the episodes.
        crawl: the simulated robot: `crawl.progress()`, `crawl.simulation.state()` and so on.
        on_interval: function to call with the `Trace` of every control interval, or None.

    Raises:
        CaterpillarError: an argument has the wrong type or is out of range.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": round(1 / CONTROL_INTERVAL_S),
    }

    def __init__(
        self,
        morphology: Morphology | Mapping[str, float] | Sequence[float] | NDArray[Any] | None = None,
        *,
        physics: Physics | Mapping[str, Any] | None = None,
        world: World | Mapping[str, Any] | str | None = None,
        action_mode: ActionMode = "timing",
        symmetric: bool = True,
        gait_period_s: float = GAIT_PERIOD_S,
        action_repeat: int = 1,
        episode_s: float = EPISODE_S,
        forward_reward_weight: float = 100.0,
        ctrl_cost_weight: float = 0.0,
        failure_cost: float = 5.0,
        reset_noise_scale: float = 0.0,
        goal_heading_rad: float = 0.0,
        randomization: Randomization | Mapping[str, Any] | None = None,
        faults: Faults | Mapping[str, Any] | int | None = None,
        terminate_on_failure: bool = True,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        camera_name: Camera = "track",
    ) -> None:
        arguments = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        EzPickle.__init__(self, **arguments)
        check_render_mode(render_mode)
        body = Morphology.of({} if morphology is None else morphology)
        self._episodes = Episodes([body], EpisodeConfig.of(arguments), threads=1)
        self.crawl = self._episodes.crawl
        self.dt = self._episodes.step_s
        self.frame_skip = round(self.dt / self.crawl.physics.timestep_s)
        self.observation_names = self._episodes.observation_names
        self.on_interval: OnInterval | None = None
        self.action_space = self._episodes.action_space
        self.observation_space = self._episodes.observation_space
        self.render_mode = render_mode
        self._pictures = Pictures(self.crawl, View(width, height, camera_name))
        self._running, self._ended = False, False
        self.metadata = self.metadata | {"render_fps": 1 / self.dt}  # one frame per step

    @property
    def morphology(self) -> Morphology:
        """Body of the robot. `reset` may change it."""
        return self._episodes.morphology(0)

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo model of the robot, without scenery. `reset` may change it."""
        return self.crawl.simulation.models[0]

    @property
    def data(self) -> mujoco.MjData:
        """Copy of the robot's MuJoCo data. All positions and velocities match `qpos` and `qvel`.

        Changes have no effect on the robot; use `set_state`.
        """
        return self.crawl.simulation.data(0)

    def get_state(self) -> EpisodeState:
        """Return everything that the rest of the episode depends on, for `set_state`.

        The state can be pickled. `CaterpillarVectorEnv.set_state` takes it too.
        """
        return self._episodes.get_state(_ROW, [self._np_random])

    def set_state(self, state: EpisodeState) -> None:
        """Continue from a state: body, conditions, motion, springs, clock and random generator.

        Raises:
            CaterpillarError: the state has several robots or another number of segments.
        """
        self._episodes.set_state(state, _ROW)
        (generator,) = state.generators
        self.np_random = make_generator(generator)  # type: ignore[assignment]  # None: unseeded
        self._running, self._ended = True, bool(self._episodes.find_ended(state)[0])

    def __getstate__(self) -> dict[str, Any]:
        """Return the arguments and the state, for `copy.deepcopy` and pickle."""
        state = self.get_state() if self._running else None
        random = copy.deepcopy((self._np_random, self._np_random_seed))
        spaces = copy.deepcopy((self.action_space, self.observation_space))  # with their generators
        kept = {"spec": self._spec, "random": random, "spaces": spaces, "state": state}
        return {**EzPickle.__getstate__(self), **kept}

    def __setstate__(self, data: dict[str, Any]) -> None:
        EzPickle.__setstate__(self, data)
        self._spec = data["spec"]
        self.action_space, self.observation_space = data["spaces"]
        if data["state"] is not None:
            self.set_state(data["state"])
        self._np_random, self._np_random_seed = data["random"]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode. `options={"morphology": ...}` changes the body from now on."""
        super().reset(seed=seed)
        chosen = check_options(options, ("morphology",))
        bodies = [Morphology.of(chosen["morphology"])] if "morphology" in chosen else None
        observation, info = self._episodes.reset(_ROW, [self.np_random], bodies)
        self._running, self._ended = True, False
        return observation[0], _scalars(info)

    def step(
        self, action: NDArray[Any]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Advance by `action_repeat` gait periods, or control intervals in switch mode."""
        if not self._running:
            raise CaterpillarError("call reset() before step()")
        if self._ended:
            gymnasium.logger.warn("the episode has ended: call reset() before step()")
        observation, reward, terminated, truncated, info = self._episodes.step(
            self._episodes.check_actions(action)[None], _ROW, self.on_interval
        )
        self._ended = bool(terminated[0] or truncated[0])
        return (
            observation[0],
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            _scalars(info),
        )

    def render(self) -> Any:
        """Draw the current state."""
        if self.render_mode is None:
            warn_of_no_render_mode()
            return None
        return self._pictures.draw(0)

    def close(self) -> None:
        """Free the drawing context."""
        self._pictures.close()


def warn_of_no_render_mode() -> None:
    """Warn that `render` draws nothing."""
    gymnasium.logger.warn(
        'render() draws nothing without a render mode: make(..., render_mode="rgb_array")'
    )


def _scalars(info: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Convert the info of a single robot from arrays to scalars."""
    scalars: dict[str, Any] = {
        key: value.item() if value.ndim == 1 else value[0] for key, value in info.items()
    }
    scalars["failure"] = Failure(scalars["failure"])
    return scalars
