"""Videos show the robot that was recorded, and leave nothing half written."""

import imageio_ffmpeg
import numpy as np
import pytest

from caterpillar_env.gait import GaitTimings
from caterpillar_env.model import Physics
from caterpillar_env.morphology import Morphology
from evolution import cli
from evolution.individual import Individual
from evolution.run import RunConfig
from evolution.video import FRAMES_PER_SECOND, VideoError, write_video

pytestmark = [
    pytest.mark.slow,
    # imageio-ffmpeg leaves the pipes of its readers, and of writers that failed, to the collector.
    pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning"),
]

PERIOD_S = RunConfig().gait_period_s


@pytest.fixture
def individual():
    timings = GaitTimings(PERIOD_S, np.array([0.0, 1.0]), np.array([1.0, 2.0]))
    return Individual(Morphology(), timings, Physics(num_segments=2), fitness_m=0.01)


def test_video_has_the_asked_size_speed_and_a_moving_picture(individual, tmp_path):
    outcomes = write_video(individual, tmp_path / "robot.mp4", speed=60.0, width=320, height=240)
    frames = imageio_ffmpeg.read_frames(str(tmp_path / "robot.mp4"))
    meta = next(frames)
    pictures = [np.frombuffer(frame, dtype=np.uint8) for frame in frames]
    assert meta["size"] == (320, 240)
    assert meta["fps"] == FRAMES_PER_SECOND
    # 30 s at 60 times the speed is half a second; a frame is drawn every 60 / 25 = 2.4 s.
    assert len(pictures) == 13
    assert pictures[0].std() > 10
    assert not np.array_equal(pictures[0], pictures[-1])
    plain = individual.simulate(threads=1)
    assert outcomes.distance_m[0] == plain.distance_m[0]
    assert [p.name for p in tmp_path.iterdir()] == ["robot.mp4"]


def test_folder_that_cannot_be_written_is_an_error_and_leaves_nothing(individual, tmp_path):
    with pytest.raises(VideoError, match="cannot write"):
        write_video(individual, tmp_path / "nowhere" / "robot.mp4", speed=60.0)
    assert list(tmp_path.iterdir()) == []


def test_replay_makes_a_video_beside_the_record(individual, tmp_path, capsys):
    individual.save(tmp_path / "best.json")
    assert cli.main(["replay", str(tmp_path)]) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["best.json", "replay.mp4"]
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "replay.mp4"))
    assert seconds == pytest.approx(15.0, abs=0.1)  # twice as fast as it was
    assert count == pytest.approx(15 * FRAMES_PER_SECOND, abs=1)
