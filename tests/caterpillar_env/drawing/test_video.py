"""Videos show recorded robots at the same times. A failed video leaves no file."""

import os
from contextlib import closing, contextmanager
from pathlib import Path
from types import SimpleNamespace

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from caterpillar_env.drawing import rendering, video
from caterpillar_env.drawing.rendering import RenderingError, RobotRenderer, View
from caterpillar_env.drawing.video import Recording, VideoConfig, is_video_of, open_video, write_video
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GAIT_PERIOD_S, GaitTimings
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot
from caterpillar_env.task import Failure

pytestmark = [
    pytest.mark.drawing,
    # imageio-ffmpeg leaves the pipes of readers and of failed writers open.
    pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning"),
]

QUICK = VideoConfig(speed=150.0, width=128, height=96)


def make_robot(length_m=0.03):
    timings = GaitTimings(GAIT_PERIOD_S, np.array([0.0, 0.1]), np.array([0.6, 0.7]))
    physics = Physics(num_segments=2)
    return Robot(Morphology(segment_length_m=length_m), timings, physics, fitness_m=0.01)


@pytest.fixture(scope="module")
def recording():
    return Recording(make_robot(), "short")


@pytest.fixture(scope="module")
def long_and_failed():
    """A longer robot whose outcome is changed to a failure (veered after 12 s)."""
    made = Recording(make_robot(0.036), "long")
    made.outcomes = made.outcomes._replace(failure=np.array([Failure.VEERED], dtype=np.int8))
    for name in ("qpos", "temperature_c", "energy_j"):
        setattr(made, name, getattr(made, name)[:1200])
    return made


def read_frames(path):
    frames = imageio_ffmpeg.read_frames(str(path))
    meta = next(frames)
    width, height = meta["size"]
    return meta, [np.frombuffer(f, dtype=np.uint8).reshape(height, width, 3).astype(int) for f in frames]


@contextmanager
def open_view(recording, width, height, camera, view_length_m):
    """Yield a function that draws a recorded robot at a given time."""
    robot = recording.robot
    view = View(width, height, camera)
    renderer = RobotRenderer(robot.morphology, robot.physics, view, view_length_m=view_length_m)
    with closing(renderer):
        yield lambda time_s: recording.draw(renderer, time_s)


# Recordings


def test_recording_repeats_the_evaluation(recording):
    plain = make_robot().simulate(threads=1)
    for traced, value in zip(recording.outcomes, plain, strict=True):
        np.testing.assert_array_equal(traced, value)
    assert recording.duration_s == 30.0
    assert recording.energy_j[-1] == plain.energy_j[0]
    assert recording.body_length_m == pytest.approx(0.06)


@pytest.fixture
def readouts(monkeypatch):
    """Readouts that are written on frames."""
    written = []
    monkeypatch.setattr(
        video, "annotate", lambda frame, readout, spring: written.append(readout) or frame
    )
    return written


def test_readout_has_time_distance_and_energy(recording, readouts):
    with open_view(recording, 64, 48, "side", recording.body_length_m) as draw:
        for time_s in (0.0, 12.0, 30.0, 99.0):
            draw(time_s)
    first, middle, last, later = readouts
    assert later == last
    assert first.time_s == pytest.approx(0.01)
    assert first.distance_m == 0.0
    assert middle.time_s == pytest.approx(12.0)
    assert 0 < middle.energy_j < last.energy_j == recording.outcomes.energy_j[0]
    assert last.distance_m == pytest.approx(recording.outcomes.distance_m[0], abs=2e-4)
    assert {r.failure for r in readouts} == {"ok"}
    assert last.title == "short"


def test_failed_robot_stops_and_shows_its_failure(long_and_failed, readouts):
    with open_view(long_and_failed, 64, 48, "track", 0.072) as draw:
        shown = [draw(time_s) for time_s in (11.9, 12.0, 25.0)]
    assert [r.failure for r in readouts] == ["ok", "veered", "veered"]
    assert readouts[-1].time_s == 12.0
    np.testing.assert_array_equal(shown[1], shown[2])
    assert (shown[0] != shown[1]).any()


def test_robot_that_diverges_is_shown_while_its_pose_is_usable(recording, monkeypatch):
    simulate = Robot.simulate

    def diverge(self, *args, on_interval, **kwargs):
        def spoilt(trace):
            count[0] += 1
            if count[0] == 3:
                trace.qpos[0, 4:] = np.nan
            on_interval(trace)

        count = [0]
        return simulate(self, *args, on_interval=spoilt, **kwargs)

    monkeypatch.setattr(Robot, "simulate", diverge)
    assert Recording(make_robot()).duration_s == pytest.approx(0.24)


# Videos


def test_video_has_the_requested_size_and_speed_and_moves(recording, tmp_path):
    write_video([recording], tmp_path / "robot.mp4", QUICK)
    meta, frames = read_frames(tmp_path / "robot.mp4")
    assert meta["size"] == (128, 96)
    assert meta["fps"] == 25
    # 30 s at 150 times the speed are 0.2 s: six frames, and the last one stays for a second.
    assert len(frames) == 6 + 25
    assert frames[0].std() > 10
    assert np.abs(frames[0] - frames[5]).max() > 50
    assert np.abs(frames[10] - frames[-1]).mean() < 3
    assert [p.name for p in tmp_path.iterdir()] == ["robot.mp4"]


def test_gif_repeats_at_the_same_speed_with_few_colours(recording, tmp_path):
    config = VideoConfig(speed=150.0, width=320, height=160)
    write_video([recording], tmp_path / "robot.gif", config)
    with Image.open(tmp_path / "robot.gif") as image:
        assert image.size == (320, 160)
        assert image.info["loop"] == 0
        first = np.asarray(image.convert("RGB")).astype(int)[:60, 140:].reshape(-1, 3)
        for rgb in ((40, 100, 235), (250, 215, 50), (235, 35, 25)):  # rare colours of the legend
            assert np.abs(first - rgb).max(axis=1).min() < 60
        lengths_ms, colours = [], set()
        for frame in range(image.n_frames):
            image.seek(frame)
            lengths_ms.append(image.info["duration"])
            colours |= {colour for _, colour in image.convert("RGB").getcolors(10_000)}
    # Identical frames may be merged into one longer frame.
    assert sum(lengths_ms) == pytest.approx((4 + 12) * 80, abs=160)
    assert 20 < len(colours) <= 128
    assert [p.name for p in tmp_path.iterdir()] == ["robot.gif"]


def test_webp_repeats_at_the_same_speed_and_is_smaller_than_a_gif(recording, tmp_path):
    config = VideoConfig(speed=150.0, width=320, height=160)
    for name in ("robot.webp", "robot.gif"):
        write_video([recording], tmp_path / name, config)
    with Image.open(tmp_path / "robot.webp") as image:
        assert image.size == (320, 160)
        assert image.info["loop"] == 0
        lengths_ms, frame = [], 0
        while sum(lengths_ms) < (4 + 12) * 80:  # n_frames counts merged frames too
            image.seek(frame)
            image.load()
            lengths_ms.append(image.info["duration"])
            frame += 1
        assert sum(lengths_ms) == pytest.approx((4 + 12) * 80, abs=160)
        assert np.asarray(image.convert("RGB")).std() > 10
    assert (tmp_path / "robot.webp").stat().st_size < (tmp_path / "robot.gif").stat().st_size


@pytest.mark.slow
def test_tiles_are_side_by_side_and_synchronized(recording, long_and_failed, tmp_path):
    config = VideoConfig(speed=300.0, width=202, height=76)
    write_video([recording, long_and_failed], tmp_path / "two.mp4", config)
    _, frames = read_frames(tmp_path / "two.mp4")
    # Times 0, 12, 24 and 30 s: the second robot stands still from 12 s on, the first one goes on.
    for number, tile in enumerate((recording, long_and_failed)):
        with open_view(tile, 100, 76, "track", long_and_failed.body_length_m) as draw:
            for time_s, frame in zip((0.0, 12.0, 24.0, 30.0), frames, strict=False):
                ours = frame[:, number * 102 : number * 102 + 100]
                assert np.abs(ours - draw(time_s)).mean() < 6, (number, time_s)
    assert np.abs(frames[1] - frames[2])[:, :98].mean() > 1
    assert np.abs(frames[1] - frames[2])[:, 104:].mean() < 1
    assert frames[0][10:-10, 100:102].mean() > 230  # the gap


def test_tiles_share_one_scale_until_the_longest_recording_ends(
    recording, long_and_failed, tmp_path, monkeypatch
):
    lengths_m = []

    def open_renderer(*arguments, view_length_m=None):
        lengths_m.append(view_length_m)
        return RobotRenderer(*arguments, view_length_m=view_length_m)

    monkeypatch.setattr(video, "RobotRenderer", open_renderer)
    path = tmp_path / "two.mp4"
    write_video([recording, long_and_failed], path, VideoConfig(speed=300.0, width=202, height=76))
    _, frames = read_frames(path)
    assert len(frames) == 4 + 25  # times 0, 12, 24 and 36 s, and the last frame for a second
    assert lengths_m == [long_and_failed.body_length_m] * 2
    assert not is_video_of(path, recording.robot)  # it shows another robot too


def test_bodies_are_shown_at_one_scale(recording):
    def body_px(view_m):
        with open_view(recording, 160, 120, "top", view_m) as draw:
            picture = draw(0.0).astype(int)
        return (picture[..., 1] > picture[..., [0, 2]].max(axis=2) + 25).sum()  # green

    assert body_px(recording.body_length_m) > 2.5 * body_px(2 * recording.body_length_m) > 0


@pytest.mark.parametrize(
    ("suffix", "size"), [(".mp4", (34, 32)), (".gif", (33, 31)), (".webp", (33, 31))]
)
def test_sizes_can_be_odd_and_a_folder_can_have_a_colon(suffix, size, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = Path(f"a:b/small{suffix}")
    path.parent.mkdir()
    with open_video(path, (33, 31), comment="robot") as write:
        for level in range(0, 250, 50):
            write(np.full((31, 33, 3), level, dtype=np.uint8))
    if suffix == ".mp4":
        assert read_frames(tmp_path / path)[0]["size"] == size
        assert is_video_of(path, SimpleNamespace(digest="robot"))
    else:
        with Image.open(path) as image:
            assert image.size == size


def test_video_names_its_robot(recording, long_and_failed, tmp_path):
    path = tmp_path / "robot.mp4"
    write_video([recording], path, QUICK)
    assert is_video_of(path, recording.robot)
    assert not is_video_of(path, long_and_failed.robot)
    path.write_bytes(recording.robot.digest.encode())
    assert not is_video_of(path, recording.robot)


@pytest.mark.parametrize(
    ("count", "layout"),
    [(1, (640, 480, 1, 1)), (2, (960, 360, 2, 1)), (3, (960, 720, 2, 2)), (5, (1440, 720, 3, 2))],
)
def test_layout(count, layout):
    assert VideoConfig().layout(count) == layout
    assert VideoConfig(width=300, height=200).layout(count) == (300, 200, *layout[2:])


# Errors


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"speed": 0.0}, r"speed = 0.0 must be a finite number from 0.01 to 1000"),
        ({"speed": float("nan")}, r"speed = nan must be a finite number"),
    ],
)
def test_values_out_of_range_are_rejected(wrong, match):
    with pytest.raises(CaterpillarError, match=match):
        VideoConfig(**wrong)


@pytest.mark.parametrize("width", [-5, 0, 10_000])
def test_impossible_sizes_are_rejected(width):
    with pytest.raises(CaterpillarError, match=r"width = -?[0-9]+ must be an integer from 1 to 8192"):
        VideoConfig(width=width)


def test_unknown_file_types_are_rejected(recording):
    with pytest.raises(
        CaterpillarError, match=r"a video must be an \.mp4, a \.gif or a \.webp file; got robot\.avi"
    ):
        write_video([recording], Path("robot.avi"))


def test_unwritable_folder_is_rejected_and_leaves_no_file(recording, tmp_path):
    with pytest.raises(CaterpillarError, match="cannot write"):
        write_video([recording], tmp_path / "nowhere" / "robot.mp4", QUICK)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_full_disk_is_reported_and_keeps_the_old_video(suffix, tmp_path):
    path = tmp_path / f"robot{suffix}"
    path.write_text("old")
    (tmp_path / f".robot.partial{suffix}").symlink_to("/dev/full")
    with (
        pytest.raises(CaterpillarError, match=rf"cannot write .*robot\{suffix}: .*No space left"),
        open_video(path, (64, 48)) as write,
    ):
        write(np.zeros((48, 64, 3), dtype=np.uint8))
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_failed_rendering_leaves_no_file(recording, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(rendering, "unavailable", "no device")
    with pytest.raises(RenderingError, match="no device"):
        write_video([recording], tmp_path / "robot.mp4", QUICK)
    assert not caplog.records  # no writer was started
    assert list(tmp_path.iterdir()) == []


def test_pipe_is_not_recognized_as_a_video(tmp_path):
    os.mkfifo(tmp_path / "best.mp4")
    assert not is_video_of(tmp_path / "best.mp4", make_robot())
