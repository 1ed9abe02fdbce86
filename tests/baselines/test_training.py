"""Trainings of small robots: what is kept, what is counted, what is refused."""

import json

import numpy as np
import pytest

from baselines import training
from baselines.config import TrainConfig, TrainingError, hyperparameters
from baselines.policy import AtRandom, Policy, TrainedRobot, judge, load
from baselines.records import RECORD, Point, Record, evaluations
from baselines.training import train
from caterpillar_env.files import FileError
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure

SMALL = Physics(num_segments=2, timestep_s=0.01)


def config(algorithm="ppo", mode="switch", **fields):
    given = {"budget_s": 300.0, "evaluations": 3, "physics": SMALL, "seed": 1}
    return TrainConfig(algorithm=algorithm, mode=mode, **{**given, **fields})


def outcome(distance_m, failure):
    return Outcomes(
        np.array([failure], dtype=np.int8), np.array([distance_m]), np.array([1.0]), np.array([3.0])
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rl") / "ppo"
    return folder, train(config(), folder)


def test_budget_counts_training_and_evaluation_and_is_spent(trained):
    _, result = trained
    assert result.finished
    first, last = result.points[0], result.points[-1].simulated_s
    assert first.simulated_s == pytest.approx(16 * 0.5 + first.time_s)  # a step of all, an evaluation
    # A step of all robots and two evaluations are kept back for the end.
    assert 300.0 - 16 * 0.5 - 2 * 30.0 - 5.0 < last <= 300.0
    assert len(result.points) >= 3


def test_folder_holds_every_evaluation_and_what_was_asked(trained):
    folder, result = trained
    assert evaluations(folder) == result.points
    record = Record.load(folder)
    assert record.config == config()
    assert record.finished
    assert record.simulated_s == result.points[-1].simulated_s
    assert {"torch", "stable-baselines3", "mujoco", "machine"} <= set(record.versions)
    learned = json.loads((folder / RECORD).read_text())["hyperparameters"]
    assert learned["env_kwargs"] == hyperparameters(config()).env_kwargs
    assert learned["model"]["learning_rate"] == hyperparameters(config()).model["learning_rate"]


def test_the_same_training_has_the_same_bits(trained, tmp_path):
    folder, result = trained
    again = train(config(), tmp_path / "again", threads=1)
    assert again.points == result.points
    one, two = (load(f, "last").actor.policy.state_dict() for f in (folder, tmp_path / "again"))
    assert all(np.array_equal(one[name], two[name]) for name in one)


def test_best_policy_crawls_as_far_again(trained):
    folder, result = trained
    robot = TrainedRobot.load(folder)
    again = float(robot.simulate().distance_m[0])
    assert again == robot.fitness_m == max(p.distance_m for p in result.points if p.failure == "ok")


class Watches:
    """A policy that never acts, and what it saw."""

    def __init__(self):
        self.seen = []

    def predict(self, observation, deterministic):
        self.seen.append(observation)
        return np.zeros((1, 4)), None


class Sevens:
    """A normalisation under which everything is a seven."""

    def normalize_obs(self, observation):
        return np.full_like(observation, 7.0)


def test_policy_sees_what_it_was_trained_to_see():
    watching = Watches()
    Policy(watching, Sevens()).crawl(judge(config()), 0, config().morphology)
    assert len(watching.seen) == 60  # steps of half a second
    assert {value for seen in watching.seen for value in seen.ravel()} == {7.0}


def test_policy_that_fails_is_not_the_best(tmp_path, monkeypatch):
    ends = iter([outcome(0.5, Failure.TIPPED), outcome(0.01, 0), outcome(0.4, Failure.VEERED)])
    monkeypatch.setattr(Policy, "crawl", lambda *_args, **_more: next(ends, outcome(0.0, 0)))
    result = train(config(), tmp_path / "run")
    assert result.best.distance_m == 0.01
    # Each policy is kept with its own record and normalisation.
    best, last = (TrainedRobot.load(tmp_path / "run", which) for which in ("best", "last"))
    assert (best.fitness_m, last.fitness_m) == (0.01, result.points[-1].distance_m)
    steps = [robot.policy.actor.num_timesteps for robot in (best, last)]
    seen = [robot.policy.normalizer.obs_rms.count for robot in (best, last)]
    assert steps[0] < steps[1]
    assert seen[1] - seen[0] == pytest.approx(steps[1] - steps[0])


def test_policies_that_all_fail_have_no_best(tmp_path, monkeypatch):
    monkeypatch.setattr(Policy, "crawl", lambda *_args, **_more: outcome(0.5, Failure.TIPPED))
    assert train(config(), tmp_path / "run").best is None
    load(tmp_path / "run")


def test_interrupt_leaves_the_policies_so_far(tmp_path):
    def stop(point: Point) -> None:
        raise KeyboardInterrupt

    result = train(config(), tmp_path / "run", on_point=stop)
    assert not result.finished
    assert not Record.load(tmp_path / "run").finished
    assert load(tmp_path / "run", "last").actor.num_timesteps >= 0


def test_progress_rises_to_the_budget(tmp_path):
    spent = []
    train(config(budget_s=150.0), tmp_path / "run", on_progress=spent.append)
    assert spent == sorted(spent)
    assert 0 < spent[0] < spent[-1] <= 150.0


def test_tensorboard_is_written_when_asked(tmp_path):
    train(config(budget_s=150.0), tmp_path / "run", tensorboard=True)
    assert list((tmp_path / "run" / "tensorboard").rglob("events*"))


def test_conditions_are_drawn_in_training_and_not_in_evaluation(tmp_path, monkeypatch):
    made = []
    original = training.CaterpillarVecEnv

    def watched(*args, **kwargs):
        made.append(original(*args, **kwargs))
        return made[-1]

    monkeypatch.setattr(training, "CaterpillarVecEnv", watched)
    plain = train(config(budget_s=150.0), tmp_path / "plain").points[0]
    drawn = train(config(budget_s=150.0, randomize={"friction": (0.2, 0.3)}), tmp_path / "drawn")
    assert drawn.points[0].distance_m == plain.distance_m  # untrained, judged under the same conditions
    frictions = [model.geom_friction[-1, 0] for model in made[1].get_attr("crawl")[0].simulation.models]
    assert 0.2 <= min(frictions) < max(frictions) <= 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("algorithm", "mode", "fields"),
    [
        ("ppo", "timing", {}),
        ("ppo", "timing", {"open_loop": True}),
        ("ppo", "timing", {"design": "preprocessed"}),
        ("ppo", "switch", {"design": "uniform"}),
        ("sac", "timing", {}),
        ("tqc", "timing", {}),
        ("ars", "timing", {}),
        ("a2c", "switch", {}),
    ],
    ids=str,
)
@pytest.mark.filterwarnings("default")
def test_every_algorithm_trains_and_comes_back(tmp_path, algorithm, mode, fields):
    asked = config(algorithm, mode, budget_s=2500.0, **fields)
    result = train(asked, tmp_path / "run")
    assert result.finished
    assert np.isfinite([p.distance_m for p in result.points]).all()
    assert load(tmp_path / "run", "last").actor._n_updates > 0
    # Learners add to their settings; the record is of what they were given.
    learned = Record.load(tmp_path / "run").hyperparameters
    assert learned == hyperparameters(asked).plain()


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_policy_learns_to_crawl_farther_than_before_and_than_at_random(tmp_path):
    """Five thousand seconds of the nominal robot: a first step, not a gait."""
    coarse = Physics(timestep_s=0.01)  # a quarter of the cost; learning is what is tested here
    asked = TrainConfig("ppo", "timing", budget_s=5000.0, evaluations=12, seed=0, physics=coarse)
    result = train(asked, tmp_path / "run")
    robot = TrainedRobot.load(tmp_path / "run")
    at_random = Policy(AtRandom(judge(asked).action_space, 0), None)
    drawn = [
        float(at_random.crawl(judge(asked), seed, asked.morphology).distance_m[0]) for seed in range(12)
    ]
    late = [p.distance_m for p in result.points[-4:]]
    assert np.median(late) > result.points[0].distance_m + 0.01
    assert robot.fitness_m > max(drawn)


def test_folder_that_holds_something_is_refused(trained):
    with pytest.raises(FileError, match="is not empty; choose another with --out"):
        train(config(), trained[0])


def test_budget_that_is_too_small_for_the_robots_is_refused(tmp_path):
    with pytest.raises(TrainingError, match="a step of all 16 robots and two evaluations take 68"):
        train(config(budget_s=40.0), tmp_path / "run")


def test_budget_in_which_bodies_cannot_evolve_is_refused(tmp_path):
    with pytest.raises(TrainingError, match="too little for bodies to evolve"):
        train(config(mode="timing", design="uniform", budget_s=1000.0), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_neighbouring_seeds_share_neither_conditions_nor_a_network(tmp_path):
    frictions = []
    with pytest.MonkeyPatch.context() as patch:
        reset = training.CaterpillarVecEnv.reset

        def watched(self):
            seen = reset(self)
            models = self.get_attr("crawl")[0].simulation.models
            frictions.append([model.geom_friction[-1, 0] for model in models])
            return seen

        patch.setattr(training.CaterpillarVecEnv, "reset", watched)
        for seed in (0, 1):
            asked = config(budget_s=150.0, seed=seed, randomize={"friction": (0.2, 1.0)})
            train(asked, tmp_path / str(seed))
    assert not set(frictions[0]) & set(frictions[1])
    # Nothing is learned in so short a time: policies are as they began.
    one, other = (load(tmp_path / str(seed), "last").actor.policy for seed in (0, 1))
    assert not np.array_equal(*(p.state_dict()["action_net.weight"] for p in (one, other)))
    np.testing.assert_allclose(one.action_net.bias.detach(), np.log(0.35 / 0.65), rtol=1e-6)


def test_folder_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="cannot write"):
        train(config(), tmp_path / "file" / "run")
