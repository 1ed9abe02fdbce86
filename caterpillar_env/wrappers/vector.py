"""A wrapper that records smooth videos of a vector environment. It needs Gymnasium 1.3 or newer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gymnasium.vector import VectorEnv
from gymnasium.wrappers import vector

from caterpillar_env.drawing import rendering
from caterpillar_env.vector_env import CaterpillarVectorEnv
from caterpillar_env.wrappers import FRAMES_PER_SECOND, check_kind, every_interval, write_frames


class RecordVideo(vector.RecordVideo[Any, Any]):
    """Gymnasium's vector `RecordVideo` with a frame for every control interval of 0.1 s.

    A video shows the robots side by side during an episode of row 0. With NEXT_STEP autoreset, the step
    that resets row 0 gives one frame only.

    Args:
        env: a `CaterpillarVectorEnv`, perhaps wrapped, with the render mode "rgb_array".
        video_folder: folder of the videos.
        video_aspect_ratio: desired width and height of the whole image.
        record_first_only: whether to show row 0 only.
        episode_trigger: see `caterpillar_env.wrappers.RecordVideo`, as for all further arguments.
        step_trigger: see there.
        video_length: see there.
        name_prefix: see there.
        fps: see there.
        disable_logger: see there.
        gc_trigger: see there.

    Raises:
        CaterpillarError: `env` is another environment.
        ValueError: `env` has no render mode.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        video_folder: str,
        video_aspect_ratio: tuple[int, int] = (1, 1),
        record_first_only: bool = False,
        episode_trigger: Callable[[int], bool] | None = None,
        step_trigger: Callable[[int], bool] | None = None,
        video_length: int = 0,
        name_prefix: str = "rl-video",
        fps: int | None = None,
        disable_logger: bool = True,
        gc_trigger: Callable[[int], bool] | None = lambda episode: True,
    ) -> None:
        check_kind(env.unwrapped, CaterpillarVectorEnv)
        super().__init__(
            env, video_folder, video_aspect_ratio, record_first_only,
            episode_trigger, step_trigger, video_length, name_prefix,
            FRAMES_PER_SECOND if fps is None else fps, disable_logger, gc_trigger,
        )  # fmt: skip
        self._drawn = False  # whether the last recorded frame shows the current state

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step, and record a frame after every control interval while recording."""
        if not self.recording or self.has_autoreset:
            return super().step(actions)
        with every_interval(self.unwrapped, self._draw):
            return super().step(actions)

    def stop_recording(self) -> None:
        """Write the video and stop recording."""
        if not write_frames(self):
            super().stop_recording()

    def _draw(self) -> None:
        if self.recording:
            self._add_frame()
            self._drawn = True

    def _capture_frame(self) -> None:
        """Record the state after a step or a reset."""
        drawn, self._drawn = self._drawn and bool(self.recorded_frames), False
        if not drawn:
            self._add_frame()

    def _add_frame(self) -> None:
        """Record the current state. On a machine that cannot draw, stop recording."""
        try:
            super()._capture_frame()
        except AssertionError:  # Gymnasium expects a sequence of frames
            if rendering.unavailable is None:
                raise
            self.stop_recording()
