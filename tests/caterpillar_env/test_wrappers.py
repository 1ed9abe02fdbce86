import gymnasium
import imageio_ffmpeg
import numpy as np
import pytest
from gymnasium.wrappers import AddWhiteNoise, RenderCollection

from caterpillar_env import CaterpillarEnv, CaterpillarError
from caterpillar_env.drawing import rendering
from caterpillar_env.task import Failure, FailureLimits
from caterpillar_env.wrappers import RecordVideo
from caterpillar_env.wrappers.vector import RecordVideo as RecordVectorVideo

pytestmark = [
    pytest.mark.drawing,
    pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning"),  # from imageio_ffmpeg
    pytest.mark.filterwarnings("ignore:.*Overwriting existing videos"),
    pytest.mark.filterwarnings("ignore:.*autoreset mode is same-step"),
]
WIDTH, HEIGHT = 64, 48
STEP = 5  # control intervals in a gait period of 0.5 s
ACTION = np.tile([-1.0, 1.0], 6)


def make(name="CaterpillarSMA-v0", render_mode="rgb_array", **kwargs):
    return gymnasium.make(
        name, render_mode=render_mode, width=WIDTH, height=HEIGHT, gait_period_s=0.5, **kwargs
    )


def make_vec(**kwargs):
    return gymnasium.make_vec(
        "CaterpillarSMA-v0", 2, render_mode="rgb_array", width=WIDTH, height=HEIGHT,
        gait_period_s=0.5, **kwargs,
    )  # fmt: skip


def always(number):
    return True


def film(env, action=ACTION):
    """Run an episode, and return its last info."""
    env.reset(seed=0)
    done = False
    while not done:
        *_, terminated, truncated, info = env.step(action)
        done = terminated or truncated
    env.close()
    return info


def length(folder, name):
    """Return the number of frames and the seconds of a video."""
    return imageio_ffmpeg.count_frames_and_secs(str(folder / f"rl-video-{name}.mp4"))


@pytest.mark.parametrize("mode", ["rgb_array", "rgb_array_list"])
def test_film_has_a_frame_of_every_interval_at_real_speed(mode, tmp_path):
    film(RecordVideo(make(render_mode=mode, episode_s=1.0), tmp_path))
    assert length(tmp_path, "episode-0") == (11, pytest.approx(1.1))


@pytest.mark.parametrize("action_repeat", [1, 2])
def test_film_of_the_switch_environment_has_every_interval(action_repeat, tmp_path):
    env = make("CaterpillarSMASwitch-v0", episode_s=0.6, action_repeat=action_repeat)
    film(RecordVideo(env, tmp_path), np.ones(12, dtype=np.int8))
    assert length(tmp_path, "episode-0") == (7, pytest.approx(0.7))


def test_given_frame_rate_sets_the_speed(tmp_path):
    film(RecordVideo(make(episode_s=1.0), tmp_path, fps=20))
    assert length(tmp_path, "episode-0") == (11, pytest.approx(0.55))


@pytest.mark.parametrize("mode", ["rgb_array", "rgb_array_list"])
def test_long_steps_give_the_same_frames_as_steps_of_one_interval(mode, tmp_path):
    """In switch mode with all springs on, Gymnasium's own frames are the reference."""
    long = RecordVideo(make("CaterpillarSMASwitch-v0", mode, action_repeat=STEP), tmp_path)
    short = RenderCollection(make("CaterpillarSMASwitch-v0"))
    for env, steps in ((long, 2), (short, 2 * STEP)):
        env.reset(seed=0)
        for _ in range(steps):
            env.step(np.ones(12, dtype=np.int8))
    recorded, expected = long.recorded_frames, short.render()
    assert len(recorded) == len(expected) == 11
    assert all(np.array_equal(a, b) for a, b in zip(recorded, expected, strict=True))
    assert (np.diff(np.array(recorded, dtype=int), axis=0) != 0).any(axis=(1, 2, 3)).all()
    long.close()
    short.close()


def test_video_holds_every_frame_once(tmp_path):
    """Gymnasium's own wrapper repeats the 24th frame, among others, and omits the next one."""
    env = RecordVideo(make(), tmp_path)
    env.reset()
    env.recorded_frames = [np.full((HEIGHT, WIDTH, 3), 3 * k, dtype=np.uint8) for k in range(80)]
    env.close()
    frames = imageio_ffmpeg.read_frames(str(tmp_path / "rl-video-episode-0.mp4"))
    next(frames)  # metadata
    levels = [np.frombuffer(frame, dtype=np.uint8).mean() for frame in frames]
    np.testing.assert_allclose(levels, 3 * np.arange(80), atol=1.4)


def test_step_that_ends_early_gives_no_extra_frames(tmp_path):
    env = RecordVideo(make(), tmp_path, episode_trigger=always)
    env.reset(seed=0)
    env.step(ACTION)
    env.unwrapped.crawl.limits = FailureLimits(sagged_share=-1.0)  # fails in the next interval
    *_, info = env.step(ACTION)
    env.reset()
    env.close()
    assert info["failure"] == Failure.SAGGED
    assert length(tmp_path, "episode-0")[0] == 1 + STEP + 1
    assert length(tmp_path, "episode-1")[0] == 1


def test_frames_show_what_wrappers_draw_over_them(tmp_path):
    plain = RecordVideo(make(), tmp_path)
    noisy = RecordVideo(RenderCollection(AddWhiteNoise(make(), 0.9)), tmp_path)
    for env in (plain, noisy):
        env.reset(seed=0)
        env.step(ACTION)
    pairs = zip(plain.recorded_frames, noisy.recorded_frames, strict=True)
    assert all(np.abs(a.astype(int) - b).mean() > 20 for a, b in pairs)
    plain.close()
    noisy.close()


def test_recording_changes_neither_results_nor_own_hooks(tmp_path):
    plain, recorded, traces = make(), RecordVideo(make(), tmp_path), []
    recorded.unwrapped.on_interval = hook = traces.append
    for env in (plain, recorded):
        env.reset(seed=0)
    for _ in range(2):
        *_, expected = plain.step(ACTION)
        *_, info = recorded.step(ACTION)
    recorded.close()
    assert info == expected
    assert len(traces) == 2 * STEP
    assert recorded.unwrapped.on_interval is hook
    assert recorded.metadata["render_fps"] == 2  # render still gives a frame per step
    assert len(recorded.render()) == HEIGHT


def test_nothing_is_drawn_between_recordings(tmp_path, monkeypatch):
    env, drawn = RecordVideo(make(), tmp_path, episode_trigger=lambda n: n == 1), []
    render = CaterpillarEnv.render
    monkeypatch.setattr(CaterpillarEnv, "render", lambda self: drawn.append(1) or render(self))
    env.reset(seed=0)
    env.step(ACTION)
    assert not drawn
    env.reset()
    env.step(ACTION)
    assert len(drawn) == 1 + STEP
    env.close()


def test_videos_can_start_at_steps_and_have_a_length(tmp_path):
    env = RecordVideo(make(), tmp_path, step_trigger=lambda n: n in (0, 2), video_length=8)
    env.reset(seed=0)
    for _ in range(5):
        env.step(ACTION)
    env.close()
    assert length(tmp_path, "step-0")[0] == 1 + 2 * STEP  # stopped at the end of a step
    assert length(tmp_path, "step-2")[0] == 1 + 2 * STEP


@pytest.mark.parametrize(("mode", "steps"), [("NextStep", 5), ("SameStep", 4)])
def test_film_of_many_robots_has_every_interval(mode, steps, tmp_path):
    envs = RecordVectorVideo(
        make_vec(episode_s=1.0, autoreset_mode=mode), tmp_path, episode_trigger=always
    )
    envs.reset(seed=0)
    shape = envs.recorded_frames[0].shape
    for _ in range(steps):
        envs.step(np.tile(ACTION, (2, 1)))
    envs.close()
    assert shape == (HEIGHT, 2 * WIDTH, 3)
    assert [length(tmp_path, f"episode-{n}")[0] for n in (0, 1)] == [1 + 2 * STEP] * 2


def test_reset_of_row_0_ends_its_film_while_others_move(tmp_path):
    envs = RecordVectorVideo(make_vec(), tmp_path, episode_trigger=always, record_first_only=True)
    actions = np.tile(ACTION, (2, 1))
    envs.reset(seed=0)
    envs.unwrapped.crawl.failure[0] = 1  # stops at once
    envs.step(actions)  # row 1 moves for the whole step, and row 0 ends
    assert len(envs.recorded_frames) == 1 + STEP
    envs.step(actions)  # row 0 is reset
    assert len(envs.recorded_frames) == 1
    envs.close()
    assert length(tmp_path, "episode-0")[0] == 1 + STEP


@pytest.mark.filterwarnings("ignore:.*(cannot draw|zero frames|numpy array)")
@pytest.mark.parametrize("wrap", [RecordVideo, RecordVectorVideo])
def test_training_goes_on_without_videos_on_a_machine_that_cannot_draw(wrap, tmp_path, monkeypatch):
    monkeypatch.setattr(rendering, "unavailable", "no device")
    env = wrap(make() if wrap is RecordVideo else make_vec(), str(tmp_path), episode_trigger=always)
    env.reset(seed=0)
    for manual in (False, True):
        if manual:
            env.start_recording("mine")
        env.step(ACTION if wrap is RecordVideo else np.tile(ACTION, (2, 1)))
        assert not env.recording
    env.close()
    assert list(tmp_path.iterdir()) == []


def test_other_environments_are_rejected(tmp_path):
    vector = gymnasium.make_vec("CaterpillarSMA-v0", 1, "sync")
    for kind, env in ((RecordVideo, gymnasium.make("CartPole-v1")), (RecordVectorVideo, vector)):
        with pytest.raises(CaterpillarError, match=r"expected a Caterpillar\w+ .*gymnasium\.wrappers"):
            kind(env, tmp_path / "none")
    vector.close()
    with pytest.raises(ValueError, match="Render mode is None"):
        RecordVideo(make(render_mode=None), tmp_path / "none")
    assert not (tmp_path / "none").exists()
