"""Training runs of small robots: records, budgets and errors."""

import io
import itertools
import json
import os
import pickle
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from baselines import codesign, training
from baselines.config import TrainConfig, Training, hyperparameters
from baselines.interface import Interface
from baselines.policy import (
    Policy,
    TrainedRobot,
    make_env,
    make_model,
    make_training_env,
)
from baselines.training import resume, train
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution.run.journal import Journal, fingerprint

SMALL = Physics(num_segments=3, timestep_s=0.01)


def config(algorithm="ppo", mode="timing", **fields):
    given = {"budget_s": 1200.0, "evaluations": 3, "physics": SMALL, "seed": 1}
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
    # The first evaluation tests the untrained policy. The second one follows a rollout.
    assert history.evaluations[0].simulated_s == 30.0
    assert history.evaluations[1].simulated_s == pytest.approx(16 * 30.0 + 30.0)
    # The budget keeps a reserve for a step of all robots and two evaluations.
    assert 1200.0 - 16 * 5.0 - 2 * 30.0 - 5.0 < history.simulated_s <= 1200.0
    assert len(history.evaluations) == 4


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
    assert (plain["algorithm"], plain["mode"]) == ("ppo", "timing")
    assert (plain["seed"], plain["budget_s"]) == (1, 1200.0)
    assert plain["hyperparameters"] == hyperparameters(config())._asdict()


@pytest.mark.slow
def test_repeated_training_run_is_bitwise_identical(trained, tmp_path):
    folder, history = trained
    again = train(config(), tmp_path / "again", threads=1).history
    assert [e[3:7] for e in again.evaluations] == [e[3:7] for e in history.evaluations]
    one, two = load_weights(folder), load_weights(tmp_path / "again")
    assert all(np.array_equal(one[name], two[name]) for name in one)


def test_last_policy_reproduces_its_recorded_distance(trained):
    folder, history = trained
    robot = TrainedRobot.load(folder, "last")
    assert robot.simulate().fitness()[0] == robot.fitness_m == history.evaluations[-1].fitness_m


def test_saved_robot_reproduces_its_distance(trained, tmp_path):
    robot = TrainedRobot.load(trained[0], "last")
    robot.save(tmp_path / "robot.json")
    again = TrainedRobot.load(tmp_path / "robot.json")
    assert again.to_dict() == robot.to_dict()
    assert again.simulate().distance_m == robot.simulate().distance_m
    slippery = robot.with_physics(friction=0.4)
    assert slippery.digest != robot.digest
    slippery.save(tmp_path / "slippery.json")
    assert TrainedRobot.load(tmp_path / "slippery.json").physics == slippery.physics


def test_loading_ignores_the_hyperparameters_of_learning(trained, tmp_path):
    robot = TrainedRobot.load(trained[0], "last")
    huge = replace(robot.config, override=("n_envs=1000000", "n_steps=1000000"))
    replace(robot, config=huge).save(tmp_path / "robot.json")
    assert TrainedRobot.load(tmp_path / "robot.json").config == huge


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "caterpillar-individual-1"}, "not a robot with a policy"),
        ({"training": 3}, "a field is missing or invalid"),
        ({"morphology": {"leg_separation_m": 0.02}}, "a field is missing or invalid"),
        ({"fitness_m": "far"}, "fitness_m = 'far' must be a finite number"),
        ({"training": {"algorithm": "dqn"}}, "algorithm = 'dqn' must be one of"),
        ({"training": {"mode": "timing"}}, "trained with other settings"),
    ],
    ids=str,
)
def test_invalid_robots_are_refused(trained, tmp_path, change, message):
    path = tmp_path / "robot.json"
    TrainedRobot.load(trained[0], "last").save(path)
    data = {k: v for k, v in json.loads(path.read_text()).items() if k != "digest"}
    path.write_text(json.dumps(data | change))
    with pytest.raises(CaterpillarError, match=message):
        TrainedRobot.load(path)


def test_damaged_or_incomplete_robots_are_refused(trained, tmp_path):
    path = tmp_path / "robot.json"
    TrainedRobot.load(trained[0], "last").save(path)
    text = path.read_text()
    path.write_text(text.replace('"seed": 1', '"seed": 2'))
    with pytest.raises(CaterpillarError, match="does not match its digest"):
        TrainedRobot.load(path)
    path.write_text(text)
    for weight in (other := load_weights(trained[0])).values():
        weight += 1
    np.savez(path.with_suffix(".npz"), **other)
    with pytest.raises(CaterpillarError, match="has other weights"):
        TrainedRobot.load(path)
    path.with_suffix(".npz").unlink()
    with pytest.raises(CaterpillarError, match="there is no such file"):
        TrainedRobot.load(path)


class Watcher:
    """A policy that does not change the gait, and stores what it observes."""

    def __init__(self):
        self.observed = []

    def predict(self, observation, deterministic):
        self.observed.append(observation)
        return np.zeros((1, 8), dtype=np.float32), None


def test_policy_observes_and_acts_through_its_interface():
    watcher = Watcher()
    interface = Interface(make_training_env(config()), mode="timing", observe=["fraction"])
    untrained = Policy(watcher, interface).crawl(make_env(config()), 0, config().morphology)
    assert [observed.shape for observed in watcher.observed] == [(1, 8)] * 6  # one per gait period
    assert untrained.distance_m[0] > 0.05  # the best wave of the prior


@pytest.mark.slow
def test_best_policy_is_the_best_of_the_history(tmp_path, monkeypatch):
    outcomes = iter([outcome(0.5, Failure.TIPPED), outcome(0.01, 0), outcome(0.4, Failure.VEERED)])
    monkeypatch.setattr(Policy, "crawl", lambda *_args, **_more: next(outcomes, outcome(0.0, 0)))
    history = train(config(), tmp_path / "run").history
    assert history.best.number == 1
    # Each policy is stored with its own record.
    best, last = (TrainedRobot.load(tmp_path / "run", which) for which in ("best", "last"))
    assert (best.fitness_m, last.fitness_m) == (0.01, history.evaluations[-1].distance_m)
    one, two = (dict(np.load(tmp_path / "run" / f"{which}.npz")) for which in ("best", "last"))
    assert not np.array_equal(one["action_net.bias"], two["action_net.bias"])


@pytest.mark.slow
def test_there_is_no_best_policy_if_all_fail(tmp_path, monkeypatch):
    monkeypatch.setattr(Policy, "crawl", lambda *_args, **_more: outcome(0.5, Failure.TIPPED))
    assert train(config(), tmp_path / "run").history.best is None
    assert TrainedRobot.load(tmp_path / "run", "last").fitness_m == 0.0
    with pytest.raises(CaterpillarError, match="contains no best policy: no policy crawled"):
        TrainedRobot.load(tmp_path / "run")


def test_interrupt_keeps_the_policies_so_far(tmp_path):
    def stop(history):
        raise KeyboardInterrupt

    assert not train(config(), tmp_path / "run", on_evaluation=stop).history.finished
    assert not Training.read(tmp_path / "run").history.finished
    assert TrainedRobot.load(tmp_path / "run", "last").fitness_m is not None


def stop_after(count):
    """A function that interrupts a training run after a number of evaluations."""
    numbers = iter(range(1, 99))

    def on_evaluation(history):
        if next(numbers) == count:
            raise KeyboardInterrupt

    return on_evaluation


def assert_same_runs(one, other):
    """Assert that two folders have the same evaluations and policies, and no checkpoint."""
    first, second = (Training.read(folder).history for folder in (one, other))
    assert first.finished
    assert second.finished
    assert [e[3:7] for e in first.evaluations] == [e[3:7] for e in second.evaluations]
    files = [sorted(path.name for path in folder.iterdir()) for folder in (one, other)]
    assert files[0] == files[1]
    assert "last.npz" in files[0]
    for name in files[0]:
        if name.endswith(".npz"):
            assert (one / name).read_bytes() == (other / name).read_bytes()


def test_resumed_training_run_is_bitwise_identical(trained, tmp_path):
    for count in (2, 4):
        folder = tmp_path / str(count)
        assert not train(config(), folder, on_evaluation=stop_after(count)).history.finished
        assert len(list(folder.glob("checkpoint-*.pt"))) == 1
        assert resume(folder, threads=1).history.finished
        assert_same_runs(trained[0], folder)


def test_resume_reports_other_versions(tmp_path, monkeypatch):
    train(config(), tmp_path, on_evaluation=stop_after(1))
    warnings = []
    found = fingerprint(training._PACKAGES)
    monkeypatch.setattr("evolution.run.loop.fingerprint", lambda packages: {**found, "torch": "9.9"})
    resume(tmp_path, on_evaluation=stop_after(1), on_warning=warnings.append)
    assert len(warnings) == 1
    assert "session 1 (evaluations 0 to 0) ran with torch 2." in warnings[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "fields",
    [
        {"algorithm": "td3"},
        {"algorithm": "td3", "open_loop": True},
        {"mode": "switch"},
        {"design": "body", "budget_s": 3000.0, "evaluations": 6, "randomize": {"friction": (0.4, 1.0)}},
        {"randomize": {"friction": (0.4, 1.0)}},
    ],
    ids=str,
)
def test_every_kind_of_training_can_be_resumed(tmp_path, monkeypatch, fields):
    monkeypatch.setattr(codesign, "FROZEN_SHARE", 0.7)  # so that frozen bodies are resumed, too
    train(config(**fields), tmp_path / "whole")
    for count in (1, 3):  # stopped after the first and second evaluations, then the third and fourth
        folder = tmp_path / str(count)
        train(config(**fields), folder, on_evaluation=stop_after(count))
        resume(folder, on_evaluation=stop_after(1))
        resume(folder)
        assert_same_runs(tmp_path / "whole", folder)


@pytest.mark.parametrize("distances_m", [(0.01, 0.02), (0.02, 0.01)], ids=["last", "earlier"])
def test_missing_best_policy_is_written_again_or_reported(tmp_path, monkeypatch, distances_m):
    outcomes = iter([outcome(0.5, Failure.TIPPED), *(outcome(metres, 0) for metres in distances_m)])
    with monkeypatch.context() as patch:
        patch.setattr(Policy, "crawl", lambda *_args, **_more: next(outcomes))
        history = train(config(evaluations=4), tmp_path, on_evaluation=stop_after(3)).history
    (tmp_path / "best.npz").unlink()
    if distances_m == (0.01, 0.02):
        assert history.best is history.evaluations[-1]
        resume(tmp_path, on_evaluation=stop_after(1))
        assert (tmp_path / "best.npz").exists()
    else:
        with pytest.raises(CaterpillarError, match=r"best\.npz is missing; restore a copy of it"):
            resume(tmp_path)


def test_first_weights_do_not_depend_on_the_number_of_threads(tmp_path):
    digests, before = [], torch.get_num_threads()
    for threads in (1, 3):
        torch.set_num_threads(threads)
        try:
            train(config(), tmp_path / str(threads), on_evaluation=stop_after(1))
            assert torch.get_num_threads() == threads
        finally:
            torch.set_num_threads(before)
        digests.append(TrainedRobot.load(tmp_path / str(threads), "last").policy.digest)
    assert digests[0] == digests[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("step", "number"),  # the best evaluation, and the last one
    [*itertools.product(["append", "complete", "_save"], [1, 3]), ("finish", 0)],
)
def test_killed_and_resumed_training_run_is_bitwise_identical(
    trained, tmp_path, monkeypatch, step, number
):
    """The process dies before it records, completes or saves an evaluation, or before it finishes."""
    owner = training._Recorder if step == "_save" else training.History
    original, calls = getattr(owner, step), iter(range(99))

    def die(*args, **kwargs):
        if next(calls) == number:
            raise KeyboardInterrupt
        return original(*args, **kwargs)

    with monkeypatch.context() as patch:
        patch.setattr(owner, step, die)
        train(config(), tmp_path / "run")
    resume(tmp_path / "run")
    assert_same_runs(trained[0], tmp_path / "run")


def test_training_with_given_springs_can_be_resumed(tmp_path):
    springs = replace(SMALL, spring_strengths=(1.0,) * 8)
    train(config(physics=springs, budget_s=150.0), tmp_path / "run", on_evaluation=stop_after(1))
    assert resume(tmp_path / "run").history.finished


def test_error_for_a_run_of_an_earlier_version_names_the_folder(trained, tmp_path):
    (tmp_path / "journal.sqlite").write_bytes((trained[0] / "journal.sqlite").read_bytes())
    with Journal(tmp_path) as journal:
        journal.begin((), journal.configuration | {"algorithm": "sac"})
    with pytest.raises(CaterpillarError, match=rf"{tmp_path}: algorithm = 'sac' .* use that version"):
        Training.read(tmp_path)


def test_finished_training_is_returned_as_it_is(trained):
    folder, history = trained
    before = (folder / "journal.sqlite").read_bytes()
    assert resume(folder).history.simulated_s == history.simulated_s
    assert (folder / "journal.sqlite").read_bytes() == before


def test_invalid_observations_are_refused_before_the_folder_is_made(tmp_path):
    given = replace(config(), override=('interface.observe=["hight"]',))
    with pytest.raises(CaterpillarError, match="observe has hight"):
        train(given, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_training_run_with_other_hyperparameters_is_not_resumed(tmp_path, monkeypatch):
    train(config(), tmp_path / "run", on_evaluation=stop_after(1))
    with Journal(tmp_path / "run") as journal:
        journal.begin((), journal.configuration | {"hyperparameters": {}})
    with pytest.raises(CaterpillarError, match="other hyperparameters"):
        resume(tmp_path / "run")


@pytest.mark.parametrize("damage", ["missing", "short", "bit", "other"])
def test_damaged_checkpoint_is_refused(tmp_path, damage):
    folder = tmp_path / "run"
    train(config(), folder, on_evaluation=stop_after(1))
    (path,) = folder.glob("checkpoint-*.pt")
    content = path.read_bytes()
    path.unlink()
    if damage == "short":
        path.write_bytes(content[:-1000])
    elif damage == "bit":
        path.write_bytes(content[:-1000] + bytes([content[-1000] ^ 1]) + content[-999:])
    elif damage == "other":
        path.write_bytes(pickle.dumps(Trap(tmp_path / "proof")))
    with pytest.raises(CaterpillarError, match=r"cannot resume from .*checkpoint-0\.pt"):
        resume(folder)
    assert not (tmp_path / "proof").exists()
    assert Training.read(folder).history.evaluations  # nothing is lost


def test_progress_increases_up_to_the_budget(tmp_path):
    spent_s = []
    train(config(budget_s=300.0), tmp_path / "run", on_progress=spent_s.append)
    assert spent_s == sorted(spent_s)
    assert 0 < spent_s[0] < spent_s[-1] <= 300.0


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


def test_neighbouring_seeds_have_different_conditions_and_weights(tmp_path, frictions):
    for seed in (0, 1):
        asked = config(budget_s=150.0, seed=seed, randomize={"friction": (0.2, 1.0)})
        train(asked, tmp_path / str(seed))
    assert not set(frictions[0]) & set(frictions[1])
    # The budget is too small for an update, so the weights are the initial ones.
    one, two = load_weights(tmp_path / "0"), load_weights(tmp_path / "1")
    assert not np.array_equal(one["action_net.weight"], two["action_net.weight"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("algorithm", "mode", "fields"),
    [
        ("ppo", "phase", {}),
        ("ppo", "timing", {"open_loop": True}),
        ("ppo", "phase", {"design": "body"}),
        ("ppo", "switch", {"design": "uniform"}),
        ("ppo", "switch", {"prior": "uniform"}),
        ("td3", "phase", {}),
        ("td3", "timing", {"open_loop": True, "prior": "uniform"}),
    ],
    ids=str,
)
def test_every_algorithm_trains_and_can_be_loaded(tmp_path, algorithm, mode, fields):
    asked = config(algorithm, mode, **fields)
    history = train(asked, tmp_path / "run").history
    assert history.finished
    assert np.isfinite([e.distance_m for e in history.evaluations]).all()
    robot = TrainedRobot.load(tmp_path / "run", "last")
    assert robot.simulate().distance_m[0] == history.evaluations[-1].distance_m
    new = Policy.of(make_model(asked, make_training_env(asked)))
    learned, initial = (p.actor.policy.state_dict() for p in (robot.policy, new))
    assert any(not torch.equal(learned[name], initial[name]) for name in learned)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ppo", "td3"])
def test_a_policy_learns_to_crawl_farther_than_the_gait_of_the_prior(tmp_path, algorithm):
    coarse = Physics(timestep_s=0.01)
    asked = TrainConfig(algorithm, budget_s=6000.0, evaluations=12, seed=3, physics=coarse)
    history = train(asked, tmp_path / "run").history
    late = [e.distance_m for e in history.evaluations[-4:]]
    assert np.median(late) > history.evaluations[0].distance_m + 0.003


def test_nonempty_folder_is_rejected(trained):
    with pytest.raises(CaterpillarError, match="is not empty"):
        train(config(), trained[0])


def test_folder_that_cannot_be_written_is_rejected(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CaterpillarError, match="cannot write"):
        train(config(), tmp_path / "file" / "run")


def test_too_small_budget_is_rejected(tmp_path):
    with pytest.raises(CaterpillarError, match="one step of 16 robots and two evaluations take 140"):
        train(config(budget_s=100.0), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_evolutionary_run_is_not_read_as_a_training_run(trained, tmp_path):
    (tmp_path / "journal.sqlite").write_bytes((trained[0] / "journal.sqlite").read_bytes())
    with Journal(tmp_path) as journal:
        journal.begin((), {k: v for k, v in journal.configuration.items() if k != "kind"})
    with pytest.raises(CaterpillarError, match="contains an evolutionary run"):
        Training.read(tmp_path)


@pytest.mark.parametrize(
    ("algorithm", "mode"),
    [("ppo", "phase"), ("ppo", "switch"), ("td3", "timing")],
)
def test_a_loaded_policy_acts_bit_for_bit_as_the_saved_one(tmp_path, algorithm, mode):
    asked = config(algorithm, mode)
    saved = Policy.of(make_model(asked, make_training_env(asked, threads=1)))
    rng = np.random.default_rng(0)
    with torch.no_grad():
        for weight in saved.actor.policy.parameters():
            weight.copy_(torch.from_numpy(0.1 * rng.normal(size=weight.shape)))
    size = saved.interface.observation_space.shape[0]
    observed = rng.normal(3.0, 2.0, (20, size)).astype(np.float32)
    expected = saved.act(observed)
    assert len(np.unique(expected, axis=0)) > 10
    saved.save(tmp_path / "best.npz")
    loaded = Policy.load(tmp_path / "best.npz", asked)
    assert loaded.act(observed).tobytes() == expected.tobytes()
    assert [path.name for path in tmp_path.iterdir()] == ["best.npz"]
    # Loading and acting do not change the file of the policy.
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
    asked, path = config(), tmp_path_factory.mktemp("policy") / "best.npz"
    Policy.of(make_model(asked, make_training_env(asked, threads=1))).save(path)
    return asked, path


def refuse(path, asked, message):
    with pytest.raises(CaterpillarError, match=f"cannot read the policy .*npz: .*{message}") as caught:
        Policy.load(path, asked)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.pop("log_std"), "arrays of another policy"),
        (lambda a: a.update(more=np.zeros(2)), "arrays of another policy"),
        (lambda a: a.update({"../up": np.zeros(2)}), "arrays of another policy"),
        (lambda a: a.update({WEIGHT: np.zeros((3, 3), np.float32)}), "must be float32 of shape"),
        (lambda a: a.update({WEIGHT: a[WEIGHT].astype(int)}), "must be float32 of shape"),
        (lambda a: a.update({WEIGHT: np.zeros(10**6)}), "arrays of another policy"),
        (lambda a: a.update({WEIGHT: a[WEIGHT] * np.float32(np.nan)}), "not finite"),
        (lambda a: a.update({WEIGHT: a[WEIGHT] + np.float32(1e30)}), "too large"),
    ],
    ids=range(8),
)
def test_arrays_that_do_not_fit_are_refused(small, tmp_path, change, message):
    asked, path = small
    arrays = dict(np.load(path))
    change(arrays)
    np.savez(tmp_path / "best.npz", **arrays)
    refuse(tmp_path / "best.npz", asked, message)


WEIGHT = "action_net.weight"


@pytest.mark.slow
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


@pytest.mark.slow
def test_damaged_policy_is_read_correctly_or_rejected(small, tmp_path):
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


def test_policy_with_other_hyperparameters_is_rejected(trained, tmp_path):
    for name in ("journal.sqlite", "last.npz"):
        (tmp_path / name).write_bytes((trained[0] / name).read_bytes())
    with Journal(tmp_path) as journal:
        recorded = journal.configuration
        changed = recorded["hyperparameters"] | {"env_kwargs": {"action_repeat": 10}}
        for learning in (changed, {}, 3):
            journal.begin((), recorded | {"hyperparameters": learning})
            with pytest.raises(CaterpillarError, match="use the version of this package"):
                TrainedRobot.load(tmp_path, "last")
