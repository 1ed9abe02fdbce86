"""Videos of a robot crawling."""

from __future__ import annotations

import os
from pathlib import Path

import imageio_ffmpeg
import mujoco
import numpy as np

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.model import SMA_STEP_S, build_model
from caterpillar_env.rendering import RobotRenderer
from caterpillar_env.simulation import Trace
from evolution.fitness import Outcomes
from evolution.individual import Robot

FRAMES_PER_SECOND = 25


class VideoError(CaterpillarError):
    """Nothing can be drawn here, or the file cannot be written."""


def write_video(
    robot: Robot,
    path: Path,
    *,
    timestep_s: float | None = None,
    speed: float = 2.0,
    width: int = 640,
    height: int = 480,
) -> Outcomes:
    """Simulate a robot and write what the tracking camera sees as MP4.

    Args:
        robot: whose body is one for all segments, or one each.
        path: of the file.
        timestep_s: another timestep than its own.
        speed: simulated seconds per second of video.
        width: of a frame, pixels, even.
        height: likewise.

    Raises:
        VideoError: no off-screen drawing on this machine, or the file cannot be written.
    """
    traces: list[Trace] = []

    def keep(trace: Trace | None) -> None:
        assert trace is not None
        traces.append(trace)

    outcomes = robot.simulate(timestep_s, on_interval=keep, trace=True)
    qpos = np.concatenate([t.qpos[0] for t in traces])
    temperature_c = np.concatenate([t.temperature_c[0] for t in traces])
    stride = max(1, round(speed / FRAMES_PER_SECOND / SMA_STEP_S))
    physics = robot.physics
    model = build_model(robot.morphology, physics, physics.strengths())
    try:
        renderer = RobotRenderer(model, mujoco.MjData(model), physics.spring, width, height)
        renderer.draw(qpos[0], temperature_c[0], "rgb_array")
    except Exception as error:  # whatever the drawing backend raises
        raise VideoError(
            f"cannot draw off-screen ({error}); install EGL (Debian: libegl1) or set MUJOCO_GL=osmesa"
        ) from error
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    writer = imageio_ffmpeg.write_frames(
        str(partial), (width, height), fps=FRAMES_PER_SECOND, macro_block_size=2, quality=7,
        output_params=["-loglevel", "quiet", "-metadata", f"comment={robot.digest}"],
    )  # fmt: skip
    try:
        writer.send(None)
        for k in range(0, len(qpos), stride):
            frame = renderer.draw(qpos[k], temperature_c[k], "rgb_array")
            assert frame is not None
            writer.send(np.ascontiguousarray(frame))
        writer.close()
        os.replace(partial, path)
    except OSError as error:
        raise VideoError(f"cannot write {path}: {error}") from None
    finally:
        writer.close()
        renderer.close()
        partial.unlink(missing_ok=True)
    return outcomes


def shows(path: Path, robot: Robot) -> bool:
    """Whether a video is of this very robot; best.mp4 outlasts its robot when a run goes on."""
    return robot.digest.encode() in path.read_bytes()
