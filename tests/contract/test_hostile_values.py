"""Every invalid value raises a one-line `CaterpillarError`, wherever it is given."""

import copy
import json
import tomllib

import numpy as np
import pytest

from caterpillar_env import (
    CaterpillarEnv,
    CaterpillarVectorEnv,
    Morphology,
    Physics,
    SmaSpring,
    physics,
    sma,
)
from caterpillar_env.errors import CaterpillarError, check_number, from_mapping
from caterpillar_env.files import parse_json, read
from caterpillar_env.gait import GaitTimings, count_steps
from caterpillar_env.randomization import Randomization
from caterpillar_env.robot import Robot, simulate, wave_robot
from caterpillar_env.worlds import WORLDS
from evolution.config import RunConfig
from evolution.genome import Encoding
from evolution.optimizers.cma_es import CmaConfig
from evolution.optimizers.ga import GaConfig
from evolution.optimizers.shade import ShadeConfig
from evolution.study.config import StudyConfig


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log when a simulation diverges


def nest(depth):
    value = []
    for _ in range(depth):
        value = [value]
    return value


HOSTILE = {
    "huge integer": 10**400, "integer of 5000 digits": 10**5000, "huge": 1e308, "tiny": 5e-324,
    "half": 0.5, "minus": -1, "huge minus": -1e308, "nan": np.nan, "inf": np.inf, "true": True,
    "text": "x", "long text": "x" * 100_000, "none": None, "list": [1], "ragged": [[1.0], [1.0, 2.0]],
    "table": {"a": 1}, "object": object(), "deep": nest(3000), "array": np.array([np.nan, 2.0]),
    "0-d array": np.array(3), "time difference": np.timedelta64(3), "number as a key": {1: 2},
}  # fmt: skip
NOT_JSON = ("object", "array", "0-d array", "time difference", "number as a key")
FROM_JSON = [value for key, value in HOSTILE.items() if key not in NOT_JSON]
STUDY = {"arms": {"ga-uniform": {"prior": "uniform"}}, "seeds": [0], "budget_s": 60}


def attempt(make, *arguments):
    """Call a function, which may succeed or raise a `CaterpillarError` of one short line."""
    try:
        make(*arguments)
    except CaterpillarError as error:
        message = str(error)
    else:
        return
    assert len(message) <= 1000
    assert message.isprintable()


SETTINGS = [
    (kind, name)
    for kind in (
        Physics,
        SmaSpring,
        Randomization,
        RunConfig,
        GaConfig,
        CmaConfig,
        ShadeConfig,
        Morphology,
        *WORLDS.values(),
    )
    for name in kind.__dataclass_fields__
]


@pytest.mark.parametrize(("kind", "name"), SETTINGS, ids=lambda v: getattr(v, "__name__", v))
def test_settings(kind, name):
    for value in HOSTILE.values():
        attempt(from_mapping, kind, {name: value}, "it")
        if kind is RunConfig:
            attempt(RunConfig.from_dict, {name: value})


def test_training_runs():
    config = pytest.importorskip("baselines.config")
    for name in config.TrainConfig.__dataclass_fields__:
        for value in FROM_JSON:
            attempt(config.TrainConfig.from_dict, {name: value})
    for value in FROM_JSON:
        attempt(config.TrainConfig.from_dict, value)


@pytest.mark.parametrize("name", [*StudyConfig.__dataclass_fields__, "base"])
def test_studies(name):
    for value in HOSTILE.values():
        attempt(StudyConfig.from_dict, STUDY | {name: value})


def test_tables_of_studies():
    for value in HOSTILE.values():
        attempt(StudyConfig.from_dict, value)
        attempt(StudyConfig.from_dict, STUDY | value if isinstance(value, dict) else value)
        for arm in ({"kind": value}, {"physics": value, "ga": {"population": value}}):
            attempt(StudyConfig.from_dict, STUDY | {"arms": {"ga-uniform": arm}})


@pytest.mark.parametrize(
    "name", ["../up", "a/b", "/etc", "", ".hidden", "a b", "<b>", "a'; DROP TABLE run", "x" * 300]
)
def test_arm_names_that_are_unsafe_as_folder_names_are_rejected(name):
    with pytest.raises(CaterpillarError, match="the name of an arm is used for a folder"):
        StudyConfig.from_dict(STUDY | {"arms": {"ga-uniform": {}, name: {}}})


@pytest.mark.parametrize(
    "name",
    [
        "morphology", "physics", "world", "action_mode", "symmetric", "gait_period_s", "action_repeat",
        "episode_s", "forward_reward_weight", "ctrl_cost_weight", "failure_cost", "reset_noise_scale",
        "goal_heading_rad", "randomization", "faults", "terminate_on_failure", "render_mode", "width",
        "height", "camera_name",
        "num_envs", "max_episode_steps", "threads", "autoreset_mode",
    ],
)  # fmt: skip
def test_arguments_of_environments(name):
    small = {"num_segments": 2}
    for key, value in HOSTILE.items():
        if key != "inf":  # a few suffice: environments take milliseconds
            attempt(lambda v: CaterpillarVectorEnv(**{"physics": small, name: v}), value)
    if name in ("morphology", "physics", "gait_period_s", "width", "render_mode"):
        for key in ("huge integer", "array"):
            attempt(lambda v: CaterpillarEnv(**{name: v}), HOSTILE[key])


@pytest.mark.parametrize("mode", ["timing", "phase", "switch"])
def test_seeds_options_and_actions(mode):
    env = CaterpillarVectorEnv(
        2, physics={"num_segments": 2}, action_mode=mode, gait_period_s=0.5, threads=1
    )
    for value in HOSTILE.values():
        attempt(lambda v: env.reset(seed=v), value)
        attempt(lambda v: env.reset(seed=[v, v]), value)
        attempt(lambda v: env.reset(options=v), value)
        attempt(lambda v: env.reset(options={"reset_mask": v}), value)
        attempt(lambda v: env.reset(options={"morphology": v}), value)
        attempt(lambda v: env.reset(options={"morphology": [v, v]}), value)
        env.reset(seed=0)
        if not isinstance(value, (int, float)):
            attempt(env.step, value)
            attempt(env.step, [value, value])


def places(data, path=()):
    """Paths of all entries of nested dicts."""
    yield path
    entries = (
        data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    )
    for key, value in entries:
        yield from places(value, (*path, key))


ROBOT = wave_robot().to_dict()


@pytest.mark.parametrize("place", list(places(ROBOT)), ids=lambda p: ".".join(map(str, p)))
def test_robots(place):
    for value in FROM_JSON:
        data = copy.deepcopy(ROBOT)
        parent = data
        for key in place[:-1]:
            parent = parent[key]
        if place:
            parent[place[-1]] = value
        attempt(Robot.from_dict, data if place else value)


def test_errors_of_genomes_and_gaits_have_one_line():
    encoding = Encoding(Physics(num_segments=2))
    for value in HOSTILE.values():
        attempt(encoding.check, value)
        attempt(encoding.check, [value] * 12)
        attempt(lambda v: GaitTimings(v, np.zeros(2), np.zeros(2)), value)
        attempt(lambda v: GaitTimings(5.0, v, v), value)
        attempt(lambda v: GaitTimings(v, [1.0], [2.0]), value)
        attempt(lambda v: count_steps(v, 0.01, "it"), value)
        attempt(lambda v: wave_robot().with_physics(timestep_s=v), value)


@pytest.mark.parametrize("seed", range(6))
def test_outcomes_are_finite_at_the_bounds_of_the_physics(seed):
    rng = np.random.default_rng(seed)
    numbers = {
        name: float(rng.choice(bounds))
        for name, bounds in (*physics.BOUNDS.items(), *sma.BOUNDS.items())
        if rng.random() < 0.5 and not name.endswith("_c")
    }
    spring = SmaSpring(**{name: value for name, value in numbers.items() if name in sma.BOUNDS})
    fixed = {"num_segments", "mismatch_seed", "spring_strengths", "timestep_s", "solver_iterations"}
    rest = {n: value for n, value in numbers.items() if n in physics.BOUNDS and n not in fixed}
    gait = GaitTimings(1.0, np.array([[0.0, 0.5]]), np.array([[0.4, 0.9]]))
    robot = Physics(num_segments=2, timestep_s=0.01, spring=spring, **rest)
    outcomes = simulate([Morphology()], gait, robot, threads=1, duration_s=1.0)
    assert np.isfinite(outcomes[1:]).all()


def test_numpy_numbers_become_python_numbers():
    config = RunConfig(seed=np.int64(3), target_m=np.float32(0.5), ga=GaConfig(population=np.int8(6)))
    assert json.loads(json.dumps(config.to_dict()))["ga"]["population"] == 6
    assert type(config.seed) is int
    assert RunConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_messages_are_short_and_quote_the_beginning_and_the_end():
    with pytest.raises(CaterpillarError) as caught:
        check_number("size", "ab\n" * 100_000, 1, 2, whole=True)
    message = str(caught.value)
    assert message.startswith("size = 'ab")
    assert message.endswith("must be an integer from 1 to 2")
    assert " [...] " in message
    assert str(CaterpillarError("two\nlines \x1b[31m")) == "two lines [31m"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("x.json", '{"a": 1, "b": {"c": 1, "c": 2}}', "x.json is not JSON: it repeats the key 'c'"),
        ("x.json", "[" * 100_000, "x.json is not JSON: "),
        ("x.json", "1" * 5000, "x.json is not JSON: "),
        ("x.toml", "a = 1\na = 2", "x.toml is not TOML: "),
        ("x.toml", "a = " + "[" * 100_000, "x.toml is not TOML: "),
        ("x.json", "\ud800", "x.json is not JSON: "),
    ],
    ids=range(6),
)  # fmt: skip
def test_files(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(CaterpillarError, match=message):
        read(path, dict, "", tomllib.loads if name.endswith("toml") else parse_json)
