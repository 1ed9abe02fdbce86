"""Co-design of bodies and a policy."""

from types import SimpleNamespace

import numpy as np
import pytest

from baselines import training
from baselines.codesign import FROZEN_SHARE, POPULATION, CoDesign
from baselines.config import TrainConfig, Training
from baselines.policy import TrainedRobot
from baselines.training import train
from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import NAMES, Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.task import Failure

SMALL = Physics(num_segments=2, timestep_s=0.01)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A training run with co-design, and the bodies of the robots in each rollout."""
    folder = tmp_path_factory.mktemp("codesign") / "run"
    bodies = []

    class Recorded(CoDesign):
        def on_rollout_start(self):
            super().on_rollout_start()
            bodies.append(list(self.training_env.get_attr("crawl")[0].simulation.bodies))

    config = TrainConfig(
        "ppo", "timing", design="uniform", budget_s=3400.0, evaluations=4, physics=SMALL
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "CoDesign", Recorded)
        train(config, folder)
    return folder, bodies


@pytest.mark.slow
def test_robots_are_divided_evenly_among_the_bodies(trained):
    _, bodies = trained
    each = len(bodies[0]) // POPULATION
    for row in range(0, len(bodies[0]), each):
        assert len(set(bodies[0][row : row + each])) == 1
    assert len(set(bodies[0])) == POPULATION
    assert set(bodies[0]) != set(bodies[1])


@pytest.mark.slow
def test_body_is_frozen_at_the_end(trained):
    _, bodies = trained
    last = len(bodies) - round(FROZEN_SHARE * len(bodies)) + 1
    assert all(len(set(rollout)) == 1 and rollout[0] == bodies[-1][0] for rollout in bodies[last:])
    assert len(set(bodies[len(bodies) // 2])) == POPULATION


@pytest.mark.slow
def test_policy_is_evaluated_in_the_current_body(trained):
    folder, bodies = trained
    recorded = Training.read(folder)
    first, last = (recorded.body(recorded.history.evaluations[place]) for place in (0, -1))
    assert first != last == bodies[-1][0]
    robot = TrainedRobot.load(folder, "last")
    assert robot.morphology == bodies[-1][0]
    assert robot.simulate().distance_m[0] == robot.fitness_m


class Env:
    """Fake training environment that stores the bodies."""

    num_envs = 16

    def set_options(self, options):
        self.bodies = options["morphology"]

    def reset(self):
        return "observations"


def make_codesign(robots=16, n_steps=6):
    vector_env = SimpleNamespace(episode_s=30.0, step_s=5.0)
    vec_env = SimpleNamespace(num_envs=robots, vector_env=vector_env)
    designs, env = CoDesign(TrainConfig(mode="timing", design="uniform"), vec_env, lambda: 0.0), Env()
    designs.model = SimpleNamespace(n_steps=n_steps, get_env=lambda: env)
    return designs, env


def test_fitness_of_a_body_is_the_mean_of_its_robots_first_episodes(monkeypatch):
    designs, env = make_codesign()
    updates = []
    monkeypatch.setattr(designs.optimizer, "tell", lambda *both: updates.append(both))
    designs.on_rollout_start()
    assert designs.model._last_obs == "observations"
    assert designs.model._last_episode_starts.tolist() == [True] * 16
    bodies = env.bodies
    ends = [{"distance": 0.01 * row, "failure": Failure.NONE} for row in range(16)]
    ends[3]["failure"] = Failure.TIPPED
    ends[5]["distance"] = -0.5
    ignored = [{"distance": 9.0, "failure": Failure.NONE}] * 16  # from a second episode
    for infos in (ends, ignored):
        designs.update_locals({"dones": np.ones(16, dtype=bool), "infos": infos})
        designs._on_step()
    designs.on_rollout_start()
    ((genomes, fitness),) = updates
    assert [Morphology.from_unit(genome) for genome in genomes] == bodies[::2] == bodies[1::2]
    assert fitness == pytest.approx([0.005, 0.01, 0.02, 0.065, 0.085, 0.105, 0.125, 0.145])


def test_prior_sets_the_start_of_the_search():
    robots = CaterpillarVecEnv("CaterpillarSMA-v0", POPULATION, threads=1)
    first = {
        design: CoDesign(TrainConfig(mode="timing", design=design), robots, lambda: 0.0).mean_body
        for design in ("uniform", "body")
    }
    np.testing.assert_allclose(first["uniform"].to_unit(), 0.5)
    genes = dict(zip(NAMES, first["body"].to_unit(), strict=True))
    assert genes["leg_separation_m"] > 0.9  # Table I of the paper: wide and low
    assert genes["segment_radius_m"] < 0.1


def test_rollout_length_must_equal_the_episode_length():
    designs, _ = make_codesign(n_steps=10)
    with pytest.raises(CaterpillarError, match="n_steps = 10 must be 6"):
        designs.on_rollout_start()
