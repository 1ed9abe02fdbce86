"""Bodies that evolve around a policy."""

from types import SimpleNamespace

import numpy as np
import pytest

from baselines.codesign import FROZEN_SHARE, POPULATION, CoDesign
from baselines.config import TrainConfig, TrainingError
from baselines.policy import TrainedRobot
from baselines.records import evaluations
from baselines.training import train
from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics

pytestmark = pytest.mark.slow
SMALL = Physics(num_segments=2, timestep_s=0.01)


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """What robots there were in each rollout of a training, and what CMA-ES was told."""
    folder = tmp_path_factory.mktemp("codesign") / "run"
    bodies, told = [], []
    with pytest.MonkeyPatch.context() as patch:
        start, tell = CoDesign._on_rollout_start, CoDesign._tell

        def started(self):
            start(self)
            bodies.append(self.training_env.get_attr("morphologies")[0])

        def telling(self):
            if self._first:
                told.append(list(self._first))
            tell(self)

        patch.setattr(CoDesign, "_on_rollout_start", started)
        patch.setattr(CoDesign, "_tell", telling)
        config = TrainConfig(
            "ppo", "timing", design="uniform", budget_s=3400.0, evaluations=4, physics=SMALL
        )
        result = train(config, folder)
    return folder, result, bodies, told


def test_each_body_is_crawled_in_by_its_share_of_the_robots(watched):
    _, _, bodies, _ = watched
    each = len(bodies[0]) // POPULATION
    for row in range(0, len(bodies[0]), each):
        assert len(set(bodies[0][row : row + each])) == 1
    assert len(set(bodies[0])) == POPULATION
    assert set(bodies[0]) != set(bodies[1])


def test_body_is_frozen_at_the_end(watched):
    _, _, bodies, _ = watched
    last = len(bodies) - round(FROZEN_SHARE * len(bodies)) + 1
    assert all(len(set(rollout)) == 1 and rollout[0] == bodies[-1][0] for rollout in bodies[last:])
    assert len(set(bodies[len(bodies) // 2])) == POPULATION


def test_every_robot_has_been_heard(watched):
    _, _, _, told = watched
    assert len(told) >= 3
    assert all(isinstance(value, float) for generation in told for value in generation)


def test_policy_is_judged_in_the_body_of_the_moment(watched):
    folder, result, bodies, _ = watched
    assert result.points[-1].morphology == bodies[-1][0]
    assert evaluations(folder) == result.points
    assert result.points[0].morphology != result.points[-1].morphology
    last = TrainedRobot.load(folder, "last")
    assert last.morphology == bodies[-1][0]
    assert last.simulate().distance_m[0] == last.fitness_m


class Env:
    """Stands for a training's environment: its bodies, and that it was started anew."""

    def set_options(self, options):
        self.bodies = options["morphology"]

    def reset(self):
        return "fresh"


def test_fitness_of_a_body_is_the_mean_of_its_robots_first_episodes(monkeypatch):
    robots = SimpleNamespace(num_envs=16, episode_s=30.0, step_s=5.0)
    designs = CoDesign(TrainConfig(mode="timing", design="uniform"), robots, lambda: 0.0)
    env, told = Env(), []
    designs.model = SimpleNamespace(n_steps=6, get_env=lambda: env)
    monkeypatch.setattr(designs._strategy, "tell", lambda *both: told.append(both))
    designs._on_rollout_start()
    assert designs.model._last_obs == "fresh"
    assert designs.model._last_episode_starts.tolist() == [True] * 16
    bodies = env.bodies
    ends = [{"distance": 0.01 * row, "failure": "ok"} for row in range(16)]
    ends[3]["failure"] = "tipped"
    ends[5]["distance"] = -0.5
    for infos in (ends, [{"distance": 9.0, "failure": "ok"}] * 16):  # another episode of each
        designs.locals = {"dones": np.ones(16, dtype=bool), "infos": infos}
        designs._on_step()
    designs._on_rollout_start()
    ((genomes, fitness),) = told
    assert [Morphology.from_unit(genome) for genome in genomes] == bodies[::2] == bodies[1::2]
    assert fitness == pytest.approx([0.005, 0.01, 0.02, 0.065, 0.085, 0.105, 0.125, 0.145])


def test_prior_sets_where_the_search_begins():
    robots = CaterpillarVecEnv("CaterpillarSMA-v0", POPULATION, threads=1)
    first = {
        design: CoDesign(TrainConfig(mode="timing", design=design), robots, lambda: 0.0).favourite
        for design in ("uniform", "preprocessed")
    }
    np.testing.assert_allclose(first["uniform"].to_unit(), 0.5)
    assert first["preprocessed"] != first["uniform"]
    assert isinstance(first["preprocessed"], Morphology)


def test_robots_must_be_shared_out_evenly():
    robots = CaterpillarVecEnv("CaterpillarSMA-v0", 3, threads=1)
    with pytest.raises(TrainingError, match="n_envs = 3 must be a multiple of 8"):
        CoDesign(TrainConfig(mode="timing", design="uniform"), robots, lambda: 0.0)
