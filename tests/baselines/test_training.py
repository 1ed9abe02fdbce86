"""Training runs of small robots: records, budgets and errors."""

import io
import os
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from baselines import training
from baselines.config import TrainConfig, Training, hyperparameters
from baselines.policy import (
    Policy,
    RandomActor,
    TrainedRobot,
    make_env,
    make_model,
    make_training_env,
)
from baselines.training import train
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution.run.journal import Journal

SMALL = Physics(num_segments=2, timestep_s=0.01)


def config(algorithm="ppo", mode="switch", **fields):
    given = {"budget_s": 300.0, "evaluations": 3, "physics": SMALL, "seed": 1}
    return TrainConfig(algorithm=algorithm, mode=mode, **{**given, **fields})


def outcome(distance_m, failure):
    return Outcomes(
        np.array([failure], dtype=np.int8), np.array([distance_m]), np.array([1.0]), np.array([3.0])
    )


def load_weights(folder):
    """Return the weights of the last policy."""
    return dict(np.load(folder / "last.npz"))


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rl") / "ppo"
    return folder, train(config(), folder).history


def test_budget_counts_training_and_evaluation_and_is_spent(trained):
    _, history = trained
    assert history.finished
    # The first evaluation, of at most 30 s, follows the first step of all robots.
    assert 16 * 0.5 < history.evaluations[0].simulated_s < 16 * 0.5 + 30.1
    # The budget keeps a reserve for a step of all robots and two evaluations.
    assert 300.0 - 16 * 0.5 - 2 * 30.0 - 5.0 < history.simulated_s <= 300.0
    assert len(history.evaluations) >= 3


def test_journal_holds_every_evaluation_and_the_configuration(trained):
    folder, history = trained
    recorded = Training.read(folder)
    assert recorded.config == config()
    assert recorded.history.finished
    assert recorded.history.simulated_s == history.simulated_s
    assert [e.distance_m for e in recorded.history.evaluations] == [
        e.distance_m for e in history.evaluations
    ]
    assert [e.generation for e in recorded.history.evaluations] == [
        e.number for e in history.evaluations
    ]
    np.testing.assert_array_equal(history.evaluations[0].genome, config().morphology.to_unit())
    (session,) = recorded.history.sessions
    assert {"torch", "stable-baselines3", "mujoco", "machine"} <= set(session.fingerprint)
    plain = recorded.history.configuration
    assert plain["kind"] == "training"
    assert (plain["algorithm"], plain["mode"]) == ("ppo", "switch")
    assert (plain["seed"], plain["budget_s"]) == (1, 300.0)
    assert plain["hyperparameters"] == hyperparameters(config())._asdict()


def test_a_repeated_training_gives_the_same_bits(trained, tmp_path):
    folder, history = trained
    again = train(config(), tmp_path / "again", threads=1).history
    assert [e[3:7] for e in again.evaluations] == [e[3:7] for e in history.evaluations]
    one, two = load_weights(folder), load_weights(tmp_path / "again")
    assert all(np.array_equal(one[name], two[name]) for name in one)


def test_last_policy_crawls_as_far_again(trained):
    folder, history = trained
    robot = TrainedRobot.load(folder, "last")
    assert robot.simulate().distance_m[0] == robot.fitness_m == history.evaluations[-1].distance_m


class Watcher:
    """A policy that does not act, and stores what it observes."""

    def __init__(self):
        self.observed = []

    def predict(self, observation, deterministic):
        self.observed.append(observation)
        return np.zeros((1, 4)), None


class Sevens:
    """A normalization that maps every value to 7."""

    def normalize_obs(self, observation):
        return np.full_like(observation, 7.0)


def test_policy_observes_normalized_values():
    watcher = Watcher()
    Policy(watcher, Sevens()).crawl(make_env(config()), 0, config().morphology)
    assert len(watcher.observed) == 60  # steps of half a second
    assert {value for observed in watcher.observed for value in observed.ravel()} == {7.0}


def test_best_policy_is_the_best_of_the_history(tmp_path, monkeypatch):
    outcomes = iter([outcome(0.5, Failure.TIPPED), outcome(0.01, 0), outcome(0.4, Failure.VEERED)])
    monkeypatch.setattr(Policy, "crawl", lambda *_args, **_more: next(outcomes, outcome(0.0, 0)))
    history = train(config(), tmp_path / "run").history
    assert history.best.number == 1
    # Each policy is stored with its own record and normalization.
    best, last = (TrainedRobot.load(tmp_path / "run", which) for which in ("best", "last"))
    assert (best.fitness_m, last.fitness_m) == (0.01, history.evaluations[-1].distance_m)
    assert not np.array_equal(*(robot.policy.normalizer.obs_rms.mean for robot in (best, last)))


def test_there_is_no_best_policy_if_all_fail(tmp_path, monkeypatch):
    monkeypatch.setattr(Policy, "crawl", lambda *_args, **_more: outcome(0.5, Failure.TIPPED))
    assert train(config(), tmp_path / "run").history.best is None
    assert TrainedRobot.load(tmp_path / "run", "last").fitness_m == 0.5
    with pytest.raises(CaterpillarError, match="contains no best policy"):
        TrainedRobot.load(tmp_path / "run")


def test_interrupt_keeps_the_policies_so_far(tmp_path):
    def stop(history):
        raise KeyboardInterrupt

    assert not train(config(), tmp_path / "run", on_evaluation=stop).history.finished
    assert not Training.read(tmp_path / "run").history.finished
    assert TrainedRobot.load(tmp_path / "run", "last").fitness_m is not None


def test_progress_increases_up_to_the_budget(tmp_path):
    spent_s = []
    train(config(budget_s=150.0), tmp_path / "run", on_progress=spent_s.append)
    assert spent_s == sorted(spent_s)
    assert 0 < spent_s[0] < spent_s[-1] <= 150.0


@pytest.fixture
def frictions(monkeypatch):
    """Friction of each robot after each reset of a training run."""
    found = []
    reset = training.CaterpillarVecEnv.reset

    def observe(self):
        observations = reset(self)
        models = self.vector_env.crawl.simulation.models
        found.append([model.geom_friction[-1, 0] for model in models])
        return observations

    monkeypatch.setattr(training.CaterpillarVecEnv, "reset", observe)
    return found


def test_only_training_is_randomized(tmp_path, frictions):
    plain = train(config(budget_s=150.0), tmp_path / "plain").history.evaluations[0]
    randomized = config(budget_s=150.0, randomize={"friction": (0.2, 0.3)})
    first = train(randomized, tmp_path / "randomized").history.evaluations[0]
    assert first.distance_m == plain.distance_m  # neither policy is trained
    assert 0.2 <= min(frictions[-1]) < max(frictions[-1]) <= 0.3


def test_neighbouring_seeds_share_neither_conditions_nor_weights(tmp_path, frictions):
    for seed in (0, 1):
        asked = config(budget_s=150.0, seed=seed, randomize={"friction": (0.2, 1.0)})
        train(asked, tmp_path / str(seed))
    assert not set(frictions[0]) & set(frictions[1])
    # The budget is too small for an update, so the weights are the initial ones.
    one, two = load_weights(tmp_path / "0"), load_weights(tmp_path / "1")
    assert not np.array_equal(one["action_net.weight"], two["action_net.weight"])
    np.testing.assert_allclose(one["action_net.bias"], np.log(0.35 / 0.65), rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("algorithm", "mode", "fields"),
    [
        ("ppo", "timing", {}),
        ("ppo", "timing", {"open_loop": True}),
        ("ppo", "timing", {"design": "body"}),
        ("ppo", "switch", {"design": "uniform"}),
        ("sac", "timing", {"budget_s": 1600.0}),  # it learns from 240 steps of 5 s on
        ("tqc", "timing", {"budget_s": 1600.0}),
        ("ars", "timing", {}),
        ("a2c", "switch", {}),
    ],
    ids=str,
)
def test_every_algorithm_trains_and_can_be_loaded(tmp_path, algorithm, mode, fields):
    asked = config(algorithm, mode, **{"budget_s": 1000.0, **fields})
    history = train(asked, tmp_path / "run").history
    assert history.finished
    assert np.isfinite([e.distance_m for e in history.evaluations]).all()
    robot = TrainedRobot.load(tmp_path / "run", "last")
    assert robot.simulate().distance_m[0] == history.evaluations[-1].distance_m
    new = Policy.of(make_model(asked, make_training_env(asked)))
    learned, initial = (p.actor.policy.state_dict() for p in (robot.policy, new))
    assert any(not torch.equal(learned[name], initial[name]) for name in learned)


@pytest.mark.slow
def test_a_policy_learns_to_crawl_farther_than_before_and_than_at_random(tmp_path):
    """Three thousand seconds of a robot of three segments: a first step, not a gait."""
    coarse = Physics(num_segments=3, timestep_s=0.01)
    asked = TrainConfig("ppo", "timing", budget_s=3000.0, evaluations=12, seed=3, physics=coarse)
    history = train(asked, tmp_path / "run").history
    env = make_env(asked)
    policy = Policy(RandomActor(env.action_space, 0), None)
    at_random = [float(policy.crawl(env, seed, asked.morphology).distance_m[0]) for seed in range(12)]
    late = [e.distance_m for e in history.evaluations[-4:]]
    assert np.median(late) > history.evaluations[0].distance_m + 0.01
    assert history.best.distance_m > max(at_random)


def test_nonempty_folder_is_rejected(trained):
    with pytest.raises(CaterpillarError, match="is not empty"):
        train(config(), trained[0])


def test_folder_that_cannot_be_written_is_rejected(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CaterpillarError, match="cannot write"):
        train(config(), tmp_path / "file" / "run")


def test_too_small_budget_is_rejected(tmp_path):
    with pytest.raises(CaterpillarError, match="one step of 16 robots and two evaluations take 68"):
        train(config(budget_s=40.0), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_evolutionary_run_is_no_training(trained, tmp_path):
    (tmp_path / "journal.sqlite").write_bytes((trained[0] / "journal.sqlite").read_bytes())
    with Journal(tmp_path) as journal:
        journal.configure({k: v for k, v in journal.configuration.items() if k != "kind"})
    with pytest.raises(CaterpillarError, match="contains an evolutionary run"):
        Training.read(tmp_path)


@pytest.mark.parametrize(
    ("algorithm", "mode"),
    [("ppo", "timing"), ("ppo", "switch"), ("a2c", "switch")]
    + [(name, "timing") for name in ("sac", "tqc", "ars")],
)
def test_a_loaded_policy_acts_bit_for_bit_as_the_saved_one(tmp_path, algorithm, mode):
    asked = config(algorithm, mode)
    saved = Policy.of(make_model(asked, make_training_env(asked, threads=1)))
    rng = np.random.default_rng(0)
    with torch.no_grad():
        for weight in saved.actor.policy.parameters():
            weight.copy_(torch.from_numpy(0.1 * rng.normal(size=weight.shape)))
    size = saved.normalizer.observation_space.shape[0]
    saved.normalizer.obs_rms.update(rng.normal(3.0, 2.0, (50, size)))
    observed = rng.normal(3.0, 2.0, (20, size)).astype(np.float32)
    expected = saved.act(observed)
    assert len(np.unique(expected, axis=0)) > (10 if mode == "timing" else 2)
    saved.save(tmp_path / "best.npz")
    loaded = Policy.load(tmp_path / "best.npz", asked)
    assert loaded.act(observed).tobytes() == expected.tobytes()
    assert [path.name for path in tmp_path.iterdir()] == ["best.npz"]
    # The same policy gives the same file, and loading does not change what it observed.
    loaded.act(observed)
    loaded.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "best.npz").read_bytes()


class Trap:
    """An object that would write a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (Path.write_text, (self.path, "run"))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """The configuration and the file of a policy."""
    asked, path = config("ars", "timing"), tmp_path_factory.mktemp("policy") / "best.npz"
    Policy.of(make_model(asked, make_training_env(asked, threads=1))).save(path)
    return asked, path


def refuse(path, asked, message):
    with pytest.raises(CaterpillarError, match=f"cannot read the policy .*npz: .*{message}") as caught:
        Policy.load(path, asked)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.pop("observation_var"), "arrays of another policy"),
        (lambda a: a.update(more=np.zeros(2)), "arrays of another policy"),
        (lambda a: a.update({"../up": np.zeros(2)}), "arrays of another policy"),
        (lambda a: a.update({WEIGHT: np.zeros((3, 3), np.float32)}), "must be float32 of shape"),
        (lambda a: a.update({WEIGHT: a[WEIGHT].astype(int)}), "must be float32 of shape"),
        (lambda a: a.update({WEIGHT: np.zeros(10**6)}), "arrays of another policy"),
        (lambda a: a.update({WEIGHT: a[WEIGHT] * np.float32(np.nan)}), "not finite"),
        (lambda a: a.update({WEIGHT: a[WEIGHT] + np.float32(1e30)}), "too large"),
        (lambda a: a.update(observation_mean=a["observation_mean"] + np.inf), "not finite"),
        (lambda a: a.update(observation_var=-a["observation_var"]), "negative"),
    ],
    ids=range(10),
)
def test_arrays_that_do_not_fit_are_refused(small, tmp_path, change, message):
    asked, path = small
    arrays = dict(np.load(path))
    change(arrays)
    np.savez(tmp_path / "best.npz", **arrays)
    refuse(tmp_path / "best.npz", asked, message)


WEIGHT = "action_net.0.weight"


def test_files_that_could_run_code_or_fill_the_memory_are_refused(small, tmp_path):
    asked, path = small
    arrays, file, proof = dict(np.load(path)), tmp_path / "best.npz", tmp_path / "proof"
    refuse(file, asked, "no such file")
    arrays[WEIGHT] = np.array([Trap(proof)], dtype=object)
    np.savez(file, allow_pickle=True, **arrays)
    refuse(file, asked, "it is damaged")
    file.write_bytes(pickle.dumps(Trap(proof)))
    refuse(file, asked, "it is damaged")
    assert not proof.exists()
    # A header that promises 4 TB, and a compressed member of 100 MB.
    header = io.BytesIO()
    shape = {"descr": "<f4", "fortran_order": False, "shape": (10**12,)}
    np.lib.format.write_array_header_1_0(header, shape)
    for content in (header.getvalue(), bytes(10**8)):
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in arrays:
                archive.writestr(f"{name}.npy", content)
        refuse(file, asked, "it is damaged|another policy")
    file.unlink()
    os.mkfifo(file)
    refuse(file, asked, "no such file")


def test_a_damaged_policy_is_read_right_or_refused(small, tmp_path):
    asked, path = small
    content, file = path.read_bytes(), tmp_path / "best.npz"
    expected = Policy.load(path, asked)._arrays()
    rng, refused = np.random.default_rng(0), 0
    cases = [content[: int(end)] for end in rng.integers(0, len(content), 20)]
    for place in rng.integers(0, len(content), 100):
        altered = bytearray(content)
        altered[place] ^= 1 << int(rng.integers(0, 8))
        cases.append(bytes(altered))
    for case in cases:
        file.write_bytes(case)
        try:
            found = Policy.load(file, asked)._arrays()
        except CaterpillarError:
            refused += 1
        else:
            assert all(np.array_equal(found[name], expected[name]) for name in expected)
    assert refused > 100


def test_a_policy_of_other_hyperparameters_is_refused(trained, tmp_path):
    for name in ("journal.sqlite", "last.npz"):
        (tmp_path / name).write_bytes((trained[0] / name).read_bytes())
    with Journal(tmp_path) as journal:
        recorded = journal.configuration
        changed = recorded["hyperparameters"] | {"env_kwargs": {"action_repeat": 10}}
        for learning in (changed, {}, 3):
            journal.configure(recorded | {"hyperparameters": learning})
            with pytest.raises(CaterpillarError, match="use the version of this package"):
                TrainedRobot.load(tmp_path, "last")
