"""Videos of robots crawling: one, or several side by side that keep time together."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import mujoco
import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.drawing.overlay import Readout
from caterpillar_env.drawing.rendering import RobotRenderer, View
from caterpillar_env.drawing.scenery import Camera
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.model import build_model
from caterpillar_env.morphology import length_m, segments_of
from caterpillar_env.physics import SMA_STEP_S
from caterpillar_env.robot import AnyRobot, Outcomes
from caterpillar_env.simulation import Trace
from caterpillar_env.task import label

Frame = NDArray[np.uint8]

#: By kind of file. Half of it is enough for GIF, which has to count in hundredths of a second.
FRAMES_PER_SECOND = {".mp4": 25.0, ".gif": 12.5}
_SINGLE_PX, _TILE_PX = (640, 480), (480, 360)
_LEAST_TILE_PX = 64
_GAP_PX = 2  # between tiles
_ANYWHERE_M = 100.0
_HOLD_S = 1.0  # how long the last picture stays
# GIF: one palette for the whole film, chosen for what moves; ordered dithering compresses.
_PALETTE = (
    "split[a][b];[a]palettegen=max_colors=128:stats_mode=full[p];"
    "[b][p]paletteuse=dither=bayer:bayer_scale=5:diff_mode=rectangle"
)
_QUIET = ["-loglevel", "quiet"]
_ENCODING: dict[str, dict[str, Any]] = {
    ".mp4": {"quality": 7, "output_params": _QUIET},
    ".gif": {
        "codec": "gif", "pix_fmt_out": "pal8", "quality": None,
        "output_params": [*_QUIET, "-filter_complex", _PALETTE],
    },
}  # fmt: skip


class VideoError(CaterpillarError):
    """A video cannot be made as asked, or its file cannot be written."""


@dataclass(frozen=True)
class VideoConfig:
    """How a video looks.

    Raises:
        VideoError: a value is out of range.
    """

    speed: float = 2.0
    """Simulated seconds per second of video."""
    width: int | None = None
    """Width of the whole picture, pixels, even; by default 640, or 480 for each of several columns."""
    height: int | None = None
    """Height of the whole picture, pixels, even; by default 480, or 360 for each of several rows."""
    camera: Camera = "track"
    """From where it is seen; all cameras follow the robot."""

    def __post_init__(self) -> None:
        if not 0 < self.speed < math.inf:
            raise VideoError(
                f"speed = {self.speed} must be a positive number of simulated seconds a second"
            )
        for name in ("width", "height"):
            pixels = getattr(self, name)
            if pixels is not None and (pixels % 2 or not _LEAST_TILE_PX <= pixels <= 4096):
                raise VideoError(
                    f"{name} = {pixels} must be an even number of pixels from {_LEAST_TILE_PX} to 4096"
                )

    def layout(self, count: int) -> tuple[int, int, int, int]:
        """Width and height of the whole picture, columns and rows of `count` tiles.

        Raises:
            VideoError: the tiles would be too small.
        """
        columns = math.ceil(math.sqrt(count))
        rows = math.ceil(count / columns)
        width, height = _SINGLE_PX if count == 1 else (_TILE_PX[0] * columns, _TILE_PX[1] * rows)
        width, height = self.width or width, self.height or height
        if min(width // columns, height // rows) < _LEAST_TILE_PX:
            raise VideoError(
                f"{count} robots in {width} x {height} pixels would be less than {_LEAST_TILE_PX} "
                "wide or high; choose a larger width and height"
            )
        return width, height, columns, rows


class Recording:
    """One robot's crawl, simulated now, to be looked at any number of times.

    Args:
        robot: of any kind.
        title: written on its pictures.
        timestep_s: another timestep than its own.
    """

    def __init__(
        self,
        robot: AnyRobot,
        title: str = "",
        *,
        timestep_s: float | None = None,
    ) -> None:
        traces: list[Trace] = []

        def keep(trace: Trace | None) -> None:
            assert trace is not None
            traces.append(trace)

        self.robot, self.title = robot, title
        self.outcomes: Outcomes = robot.simulate(timestep_s, on_interval=keep, trace=True)
        qpos = np.concatenate([t.qpos[0] for t in traces])
        # A robot that breaks down is shown as long as it is anywhere.
        shown = max(1, int(np.cumprod((np.abs(qpos) < _ANYWHERE_M).all(axis=1)).sum()))
        self._qpos = qpos[:shown]
        self._temperature_c = np.concatenate([t.temperature_c[0] for t in traces])[:shown]
        self._energy_j = np.concatenate([t.energy_j[0] for t in traces])[:shown]
        physics = robot.physics
        self.body_length_m = length_m(segments_of(robot.morphology, physics.num_segments))

    @property
    def duration_s(self) -> float:
        """Simulated seconds until the end or the failure."""
        return len(self._qpos) * SMA_STEP_S

    @contextmanager
    def seen(
        self, width: int, height: int, camera: Camera, view_m: float
    ) -> Iterator[Callable[[float], Frame]]:
        """A function that draws the robot at a time in s; from its end on it stands still.

        Args:
            width: of a picture, pixels.
            height: likewise.
            camera: from where.
            view_m: length of body that the picture is wide enough for.
        """
        physics = self.robot.physics
        model = build_model(self.robot.morphology, physics)
        model.cam_poscom0[:] *= view_m / self.body_length_m
        renderer = RobotRenderer(
            model, mujoco.MjData(model), physics.spring, View(width, height, camera)
        )
        start_m = renderer.centre_of_mass(self._qpos[0])[0]
        failure, last = label(self.outcomes.failure[0]), len(self._qpos) - 1
        drawn: dict[int, Frame] = {}

        def draw(time_s: float) -> Frame:
            k = min(max(round(time_s / SMA_STEP_S) - 1, 0), last)
            if k not in drawn:
                readout = Readout(
                    (k + 1) * SMA_STEP_S,
                    renderer.centre_of_mass(self._qpos[k])[0] - start_m,
                    float(self._energy_j[k]),
                    failure if k == last else "ok",
                    self.title,
                )
                frame = renderer.draw(self._qpos[k], self._temperature_c[k], "rgb_array", readout)
                assert frame is not None
                drawn.clear()
                drawn[k] = frame
            return drawn[k]

        with closing(renderer):
            yield draw


def write_video(recordings: Sequence[Recording], path: Path, config: VideoConfig | None = None) -> None:
    """Write robots crawling side by side, at the same times and the same scale.

    Args:
        recordings: one or more.
        path: of the file, .mp4 or .gif.
        config: how it looks.

    Raises:
        RenderingError: nothing can be drawn on this machine.
        VideoError: another kind of file, too small, or the file cannot be written.
    """
    config = config or VideoConfig()
    check_kind(path)
    width, height, columns, rows = config.layout(len(recordings))
    fps = FRAMES_PER_SECOND[path.suffix]
    view_m = max(r.body_length_m for r in recordings)
    tile = (width - _GAP_PX * (columns - 1)) // columns, (height - _GAP_PX * (rows - 1)) // rows
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    with ExitStack() as stack:
        draws = [stack.enter_context(r.seen(*tile, config.camera, view_m)) for r in recordings]
        for draw in draws:
            draw(0.0)  # where this fails, no file is begun
        canvas = np.full((height, width, 3), 255, dtype=np.uint8)
        stack.callback(partial.unlink, missing_ok=True)
        encoding = deepcopy(_ENCODING[path.suffix])
        encoding["output_params"] += ["-metadata", f"comment={_who(recordings)}"]
        writer = imageio_ffmpeg.write_frames(
            str(partial), (width, height), fps=fps, macro_block_size=2, **encoding
        )
        stack.callback(writer.close)
        try:
            writer.send(None)
            for time_s in _times(max(r.duration_s for r in recordings), config.speed, fps):
                for number, draw in enumerate(draws):
                    row, column = divmod(number, columns)
                    x, y = column * (tile[0] + _GAP_PX), row * (tile[1] + _GAP_PX)
                    canvas[y : y + tile[1], x : x + tile[0]] = draw(time_s)
                writer.send(canvas)
            writer.close()
            os.replace(partial, path)
        except OSError as error:
            raise VideoError(f"cannot write {path}: {str(error).splitlines()[0]}") from None


def _who(recordings: Sequence[Recording]) -> str:
    return " ".join(recording.robot.digest for recording in recordings)


def shows(path: Path, robot: AnyRobot) -> bool:
    """Whether a video is of this very robot; best.mp4 outlasts its robot when a run goes on."""
    return robot.digest.encode() in path.read_bytes()


def _times(duration_s: float, speed: float, fps: float) -> Array:
    """Simulated time of each frame, s; the last one stays for a while."""
    moving = math.ceil(duration_s * fps / speed) + 1
    times: Array = np.minimum(np.arange(moving + round(_HOLD_S * fps)) * speed / fps, duration_s)
    return times


def check_kind(path: Path) -> None:
    """Whether a video can have this name and place.

    Raises:
        VideoError: neither .mp4 nor .gif, or no folder that can be written to.
    """
    if path.suffix not in FRAMES_PER_SECOND:
        raise VideoError(f"a video is an .mp4 or a .gif file; got {path}")
    folder = path.parent
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        what = "cannot be written" if folder.is_dir() else "is no folder"
        raise VideoError(f"cannot write {path}: {folder} {what}; choose another place with --out")
