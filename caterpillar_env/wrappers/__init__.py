"""A wrapper that records smooth videos. `caterpillar_env.wrappers.vector` has its vector version."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import wrappers

from caterpillar_env.drawing.video import open_video
from caterpillar_env.env import CaterpillarEnv
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import CONTROL_INTERVAL_S
from caterpillar_env.pose import Trace
from caterpillar_env.task import OnInterval

#: Frames per simulated second: one per control interval.
FRAMES_PER_SECOND = round(1 / CONTROL_INTERVAL_S)


class RecordVideo(wrappers.RecordVideo[Any, Any]):
    """Gymnasium's `RecordVideo` with a frame for every control interval of 0.1 s.

    Gymnasium's own wrapper keeps one frame per step, and a step of `CaterpillarSMA-v0` takes 5 s. Frames
    are drawn only while a video is recorded. The wrapper does not change the results of `render`.
    Like Gymnasium's wrapper, it needs moviepy.

    Args:
        env: a `CaterpillarEnv`, perhaps wrapped, with the render mode "rgb_array" or "rgb_array_list".
        video_folder: folder of the videos.
        episode_trigger: function that takes an episode number and returns whether to record the episode.
        step_trigger: function that takes a step number and returns whether to start a video after it.
        video_length: number of frames after which a video ends, at the end of a step; 0 for whole
            episodes.
        name_prefix: start of the file names.
        fps: frames per second of video. The default, 10, plays at real speed, and 20 twice as fast.
        disable_logger: has no effect, because no progress is shown.
        gc_trigger: function that takes an episode number and returns whether to collect garbage after
            its video.

    Raises:
        CaterpillarError: `env` is another environment.
        ValueError: `env` has no render mode.
        gymnasium.error.DependencyNotInstalled: moviepy is missing.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        video_folder: str,
        episode_trigger: Callable[[int], bool] | None = None,
        step_trigger: Callable[[int], bool] | None = None,
        video_length: int = 0,
        name_prefix: str = "rl-video",
        fps: int | None = None,
        disable_logger: bool = True,
        gc_trigger: Callable[[int], bool] | None = lambda episode: True,
    ) -> None:
        check_kind(env.unwrapped, CaterpillarEnv)
        super().__init__(
            env, video_folder, episode_trigger, step_trigger, video_length, name_prefix,
            FRAMES_PER_SECOND if fps is None else fps, disable_logger, gc_trigger,
        )  # fmt: skip
        self._drawn = False  # whether the last recorded frame shows the current state
        self._source = cast(Any, env)  # renders single frames
        while self._source.render_mode.endswith("_list"):
            self._source = self._source.env

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and record a frame after every control interval while recording."""
        if not self.recording:
            return super().step(action)
        with every_interval(self.unwrapped, self._draw):
            return super().step(action)

    def stop_recording(self) -> None:
        """Write the video and stop recording."""
        if not write_frames(self):
            super().stop_recording()  # type: ignore[no-untyped-call]

    def _draw(self) -> None:
        frame = self._source.render()
        if frame is not None:  # Gymnasium stops recording at the end of the step otherwise
            self.recorded_frames.append(frame)
            self._drawn = True

    def _capture_frame(self) -> None:
        """Record the state after a step or a reset."""
        drawn, self._drawn = self._drawn and bool(self.recorded_frames), False
        if drawn and self._source is self.env:
            return
        if drawn:  # Gymnasium appends this frame again, from its own list of frames
            self.recorded_frames.pop()
        super()._capture_frame()  # type: ignore[no-untyped-call]


def write_frames(wrapper: Any) -> bool:
    """Write the recorded frames of a wrapper to a video, and end the recording.

    Without frames, this function does nothing and returns False. Gymnasium uses moviepy instead, which
    repeats some frames and omits others because of rounding errors.
    """
    frames = wrapper.recorded_frames
    if not frames:
        return False
    path = Path(wrapper.video_folder) / f"{wrapper._video_name}.mp4"
    height, width, _ = frames[0].shape
    with open_video(path, (width, height), fps=wrapper.frames_per_sec) as write:
        for frame in frames:
            write(np.ascontiguousarray(frame))
    wrapper.recorded_frames, wrapper.recording, wrapper._video_name = [], False, None
    if wrapper.gc_trigger and wrapper.gc_trigger(wrapper.episode_id):
        gc.collect()
    return True


def check_kind(env: Any, kind: type) -> None:
    """Raise a `CaterpillarError` if `env` is not an instance of `kind`."""
    if not isinstance(env, kind):
        raise CaterpillarError(
            f"expected a {kind.__name__} to record; got {type(env).__name__}. For other "
            "environments, use the RecordVideo of gymnasium.wrappers or of gymnasium.wrappers.vector"
        )


@contextmanager
def every_interval(env: Any, call: Callable[[], None]) -> Iterator[None]:
    """Call a function after every control interval of `env`, in addition to its `on_interval`."""
    own: OnInterval | None = env.on_interval

    def on_interval(trace: Trace) -> None:
        if own is not None:
            own(trace)
        call()

    env.on_interval = on_interval
    try:
        yield
    finally:
        env.on_interval = own
