"""Bodies that evolve around a policy."""

import numpy as np
import pytest

from baselines.codesign import FROZEN_SHARE, POPULATION, CoDesign
from baselines.config import TrainConfig, TrainingError
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
            "ppo", "timing", design="uniform", budget_s=3000.0, evaluations=4, physics=SMALL
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
