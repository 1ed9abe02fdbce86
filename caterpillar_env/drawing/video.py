"""Videos of one robot, or of several robots side by side."""

from __future__ import annotations

import math
import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

from caterpillar_env.drawing.overlay import Readout, annotate
from caterpillar_env.drawing.rendering import RobotRenderer, View
from caterpillar_env.drawing.scenery import Camera
from caterpillar_env.errors import CaterpillarError, check_fields
from caterpillar_env.files import ELSEWHERE
from caterpillar_env.morphology import length_m
from caterpillar_env.physics import SMA_STEP_S
from caterpillar_env.robot import AnyRobot, Outcomes
from caterpillar_env.task import Failure

_SINGLE_PX, _TILE_PX = (640, 480), (480, 360)
_GAP_PX = 2  # between tiles
_USABLE_M = 100.0  # coordinate limit of a drawable pose
_HOLD_S = 1.0  # duration of the still image at the end
# GIFs use one palette for the whole video, and ordered dithering because it compresses well.
_PALETTE = (
    "split[a][b];[a]palettegen=max_colors=128:stats_mode=full[p];"
    "[b][p]paletteuse=dither=bayer:bayer_scale=5:diff_mode=rectangle"
)
_PAD = "pad=ceil(iw/2)*2:ceil(ih/2)*2"  # H.264 needs an even width and height
#: Frames per second, and options of ffmpeg. GIF frame times are multiples of 10 ms.
_ENCODING = {
    ".mp4": (25.0, ["-vf", _PAD, "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "15"]),
    ".gif": (12.5, ["-filter_complex", _PALETTE, "-c:v", "gif", "-pix_fmt", "pal8"]),
    ".webp": (12.5, ["-c:v", "libwebp_anim", "-pix_fmt", "yuv420p", "-quality", "60", "-loop", "0"]),
}


@dataclass(frozen=True)
class VideoConfig:
    """Speed, size and camera of a video.

    Raises:
        CaterpillarError: the speed, the size or the camera is invalid.
    """

    speed: float = 2.0
    """Simulated seconds per second of video, from 0.01 to 1000."""
    width: int | None = None
    """Frame width in pixels; by default 640, or 480 per column with several robots."""
    height: int | None = None
    """Frame height in pixels; by default 480, or 360 per row with several robots."""
    camera: Camera = "track"
    """Name of the camera. All cameras follow the robot."""

    def __post_init__(self) -> None:
        check_fields(self, {"speed": (0.01, 1000.0), "width": (1, 8192), "height": (1, 8192)})

    def layout(self, count: int) -> tuple[int, int, int, int]:
        """Return the frame width and height, and the number of columns and rows, for `count` tiles.

        Raises:
            CaterpillarError: the frame is too small.
        """
        columns = math.ceil(math.sqrt(count))
        rows = math.ceil(count / columns)
        width, height = _SINGLE_PX if count == 1 else (_TILE_PX[0] * columns, _TILE_PX[1] * rows)
        width, height = self.width or width, self.height or height
        for name, size, tiles in (("width", width, columns), ("height", height, rows)):
            least = tiles + _GAP_PX * (tiles - 1)
            if size < least:
                raise CaterpillarError(f"{name} = {size} must be at least {least} for {count} robots")
        return width, height, columns, rows


class Recording:
    """Simulated motion of a robot, which can be drawn repeatedly.

    Args:
        robot: the robot to simulate.
        title: text to write on the frames.
    """

    def __init__(self, robot: AnyRobot, title: str = "") -> None:
        traces: list[Any] = []
        self.robot, self.title = robot, title
        self.outcomes: Outcomes = robot.simulate(on_interval=traces.append)
        qpos = np.concatenate([t.qpos[0] for t in traces])
        # Cut the trace at the first pose of a diverging robot that cannot be drawn.
        shown = max(1, int(np.cumprod((np.abs(qpos) < _USABLE_M).all(axis=1)).sum()))
        self.qpos = qpos[:shown]  #: positions after each thermal step, (steps, nq)
        self.temperature_c = np.concatenate([t.temperature_c[0] for t in traces])[:shown]
        self.energy_j = np.concatenate([t.energy_j[0] for t in traces])[:shown]  #: used so far, J
        self.body_length_m = length_m(robot.morphology, robot.physics.num_segments)

    @property
    def duration_s(self) -> float:
        """Simulated time until the end of the episode or the failure, s."""
        return len(self.qpos) * SMA_STEP_S

    def draw(self, renderer: RobotRenderer, time_s: float) -> NDArray[np.uint8]:
        """Return the frame at a time, s. Later times show the final pose."""
        last = len(self.qpos) - 1
        step = min(max(round(time_s / SMA_STEP_S) - 1, 0), last)
        start_m, now_m = (renderer.centre_of_mass(self.qpos[k])[0] for k in (0, step))
        failure = Failure(self.outcomes.failure[0]).label if step == last else "ok"
        readout = Readout(
            (step + 1) * SMA_STEP_S, now_m - start_m, self.energy_j[step], failure, self.title
        )
        frame = renderer.draw(self.qpos[step], self.temperature_c[step])
        return annotate(frame, readout, self.robot.physics.spring)


def write_video(recordings: Sequence[Recording], path: Path, config: VideoConfig | None = None) -> None:
    """Write a video of robots side by side, at the same simulated time and scale.

    Args:
        recordings: one or more recorded robots.
        path: path of the .mp4, .gif or .webp file.
        config: speed, size and camera.

    Raises:
        RenderingError: rendering is not possible on this machine.
        CaterpillarError: the file type is unknown, or writing fails.
    """
    config = config or VideoConfig()
    check_path(path)
    width, height, columns, rows = config.layout(len(recordings))
    fps, _ = _ENCODING[path.suffix]
    view_length_m = max(r.body_length_m for r in recordings)
    tile = (width - _GAP_PX * (columns - 1)) // columns, (height - _GAP_PX * (rows - 1)) // rows
    view = View(*tile, config.camera)
    with ExitStack() as stack:
        films = []
        for recording in recordings:
            robot = recording.robot
            renderer = RobotRenderer(robot.morphology, robot.physics, view, view_length_m=view_length_m)
            stack.callback(renderer.close)
            recording.draw(renderer, 0.0)  # raise errors before the file is created
            films.append((recording, renderer))
        canvas = np.full((height, width, 3), 255, dtype=np.uint8)
        comment = " ".join(recording.robot.digest for recording in recordings)
        write = stack.enter_context(open_video(path, (width, height), comment=comment))
        end_s = max(r.duration_s for r in recordings)
        for time_s in np.arange(math.ceil(end_s * fps / config.speed) + 1) * config.speed / fps:
            for number, (recording, renderer) in enumerate(films):
                row, column = divmod(number, columns)
                x, y = column * (tile[0] + _GAP_PX), row * (tile[1] + _GAP_PX)
                canvas[y : y + tile[1], x : x + tile[0]] = recording.draw(renderer, time_s)
            write(canvas)
        for _ in range(round(_HOLD_S * fps)):
            write(canvas)


@contextmanager
def open_video(
    path: Path, size: tuple[int, int], *, fps: float | None = None, comment: str = ""
) -> Iterator[Callable[[NDArray[np.uint8]], object]]:
    """Yield a function that appends a frame to a new video. The file appears when it is complete.

    Args:
        path: path of the .mp4, .gif or .webp file.
        size: width and height of the frames, pixels.
        fps: frames per second; by default 25 (.mp4) or 12.5.
        comment: comment in the metadata.

    Raises:
        CaterpillarError: writing fails.
    """
    rate, options = _ENCODING[path.suffix]
    rate, (width, height) = fps or rate, size
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(rate), "-i", "-",
        *options, "-metadata", f"comment={comment}", f"file:{partial}",
    ]  # fmt: skip
    # Ctrl-C stops all processes of a group, so ffmpeg gets its own group.
    with tempfile.TemporaryFile() as messages:
        try:
            with subprocess.Popen(
                command, stdin=subprocess.PIPE, stderr=messages, process_group=0
            ) as process:
                assert process.stdin is not None
                try:
                    yield cast(Callable[[NDArray[np.uint8]], object], process.stdin.write)
                except KeyboardInterrupt:
                    process.kill()
                    raise
            if process.returncode != 0:
                raise OSError(f"ffmpeg ended with status {process.returncode}")
            os.replace(partial, path)
        except OSError as error:
            messages.seek(0)
            reason = (messages.read().decode(errors="replace").strip() or str(error)).splitlines()[0]
            raise CaterpillarError(f"cannot write {path}: {reason}") from None
        finally:
            partial.unlink(missing_ok=True)


def is_video_of(path: Path, robot: AnyRobot) -> bool:
    """Return whether `write_video` wrote this file for this robot, by the digest in the metadata."""
    if not path.is_file():  # ffmpeg would block if `path` is a named pipe
        return False
    options = ["-loglevel", "quiet", "-i", f"file:{path}", "-f", "ffmetadata", "-"]
    read = [imageio_ffmpeg.get_ffmpeg_exe(), *options]
    metadata = subprocess.run(read, capture_output=True, text=True, check=False).stdout
    return f"comment={robot.digest}" in metadata.splitlines()


def check_path(path: Path) -> None:
    """Check that a video can be written to `path`.

    Raises:
        CaterpillarError: the file type is unknown, or the folder is missing or not writable.
    """
    if path.suffix not in _ENCODING:
        raise CaterpillarError(f"a video must be an .mp4, a .gif or a .webp file; got {path}")
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise CaterpillarError(
            f"cannot write {path}: {path.parent} is not a writable folder; {ELSEWHERE}"
        )
