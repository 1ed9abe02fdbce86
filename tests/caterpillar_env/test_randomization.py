"""Conditions sampled at reset: ranges, seeding, info entries and effects."""

import gymnasium
import mujoco
import numpy as np
import pytest

import caterpillar_env  # noqa: F401
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.model import build_model
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.randomization import Conditions, Randomization, apply_conditions
from caterpillar_env.simulation import Simulation

RANGES = {
    "friction": (0.4, 1.2), "mismatch_std": (0.0, 0.2), "spring_force": (0.8, 1.2), "mass": (0.9, 1.1),
    "ambient_c": (15.0, 35.0),
}  # fmt: skip
P = Physics(num_segments=2, timestep_s=0.01)


def conditions(**changes):
    nominal = {
        "friction": P.friction, "strengths": tuple(P.strengths().tolist()), "mass": 1.0,
        "ambient_c": P.spring.ambient_c,
    }  # fmt: skip
    return Conditions(**{**nominal, **changes})


def arrays(model):
    names = [n for n in dir(model) if not n.startswith("_")]
    return {n: getattr(model, n) for n in names if isinstance(getattr(model, n), np.ndarray)}


# Effects of conditions


def test_mass_factor_equals_a_heavier_body():
    body = Morphology()
    light = build_model(body, P, scenery=False)
    heavy = build_model(Morphology(segment_mass_kg=1.25 * body.segment_mass_kg), P, scenery=False)
    made = apply_conditions(light, P, conditions(mass=1.25))
    for name, value in arrays(heavy).items():
        np.testing.assert_allclose(getattr(made, name), value, rtol=1e-12, atol=1e-15, err_msg=name)


def test_spring_and_friction_factors_equal_different_physics():
    other = Physics(num_segments=2, timestep_s=0.01, friction=0.3, spring_strengths=(1.5,) * 4)
    expected = build_model(Morphology(), other, scenery=False)
    made = apply_conditions(
        build_model(Morphology(), P, scenery=False), P,
        conditions(friction=0.3, strengths=(1.5,) * 4),
    )  # fmt: skip
    for name, value in arrays(expected).items():
        np.testing.assert_allclose(getattr(made, name), value, rtol=1e-12, atol=1e-15, err_msg=name)


def test_original_model_is_not_changed():
    model = build_model(Morphology(), P, scenery=False)
    before = {name: value.copy() for name, value in arrays(model).items()}
    apply_conditions(model, P, conditions(mass=2.0, friction=0.1, strengths=(2.0,) * 4))
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(model, name), value, err_msg=name)


def test_springs_in_colder_air_start_colder_and_transform_later():
    simulation = Simulation([Morphology()] * 3, P, 1)
    met = [conditions(ambient_c=c) for c in (5.0, P.spring.ambient_c, 45.0)]
    simulation.reset(conditions=met)
    np.testing.assert_allclose(simulation.state().temperature_c.T, [[5.0, 25.0, 45.0]] * 4)
    simulation.advance(simulation.heat(np.ones((3, 60, 4))))
    cold, nominal, warm = simulation.state().temperature_c[:, 0]
    assert cold < nominal < warm
    assert simulation.state().fraction[0, 0] < simulation.state().fraction[2, 0]
    simulation.advance(simulation.heat(np.zeros((3, 6000, 4))))
    np.testing.assert_allclose(simulation.state().temperature_c.T, [[5.0, 25.0, 45.0]] * 4, atol=0.01)


def test_nominal_conditions_do_not_change_the_result():
    plain, met = (Simulation([Morphology()], P, 1) for _ in range(2))
    met.reset(conditions=[conditions()])
    power = np.zeros((1, 300, 4))
    power[:, :100, 0] = 1.0
    for simulation in (plain, met):
        simulation.advance(simulation.heat(power))
    np.testing.assert_array_equal(plain.qpos(0), met.qpos(0))


def test_reset_without_conditions_restores_those_of_physics():
    simulation, fresh = (Simulation([Morphology()], P, 1) for _ in range(2))
    simulation.reset(conditions=[conditions(friction=0.1, ambient_c=40.0, mass=1.3)])
    for one in (simulation, fresh):
        one.reset()
        one.advance(one.heat(np.ones((1, 100, 4))))
    np.testing.assert_array_equal(simulation.qpos(0), fresh.qpos(0))


# Sampling


def test_samples_fill_their_ranges():
    rng, randomization = np.random.default_rng(0), Randomization(**RANGES)
    samples = [randomization.draw(P, rng) for _ in range(400)]
    for name in ("friction", "mass", "ambient_c"):
        low, high = RANGES[name]
        values = np.array([getattr(c, name) for c in samples])
        assert low <= values.min() < low + 0.02 * (high - low)
        assert high - 0.02 * (high - low) < values.max() <= high
    strengths = np.array([c.strengths for c in samples])
    assert strengths.mean() == pytest.approx(1.0, abs=0.02)
    assert strengths.std() == pytest.approx(np.sqrt(0.2**2 / 3 + 0.4**2 / 12), rel=0.1)
    # The samples of different conditions are uncorrelated.
    together = np.corrcoef(
        [(c.friction, c.mass, c.ambient_c, np.mean(c.strengths)) for c in samples], rowvar=False
    )
    assert np.abs(together - np.eye(4)).max() < 0.2


def test_conditions_without_a_range_keep_the_values_of_physics():
    samples = Randomization(friction=(0.4, 1.2)).draw(P, np.random.default_rng(0))
    assert samples == conditions(friction=samples.friction)


def test_adding_a_range_does_not_change_the_other_samples():
    few = Randomization(mass=(0.9, 1.1)).draw(P, np.random.default_rng(3))
    many = Randomization(**RANGES).draw(P, np.random.default_rng(3))
    assert few.mass == many.mass


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"friction": (1.0, 0.5)}, r"friction must be \(lower, upper\) with 0 <= lower <= upper <= 100"),
        ({"friction": 0.5}, r"must be \(lower, upper\) with"),
        ({"mass": (0.0, 1.0)}, r"mass must be \(lower, upper\) with 0.01 <= lower"),
        ({"ambient_c": (20.0, np.inf)}, "randomization of ambient_c"),
        ({"luck": (0, 1)}, "randomization has no luck; its fields are friction, mismatch_std"),
        ([1], "randomization must be a mapping"),
    ],
    ids=str,
)
def test_invalid_ranges_are_rejected(ranges, message):
    with pytest.raises(CaterpillarError, match=message):
        Randomization.of(ranges)


def test_air_too_warm_for_cooling_is_rejected():
    with pytest.raises(CaterpillarError, match=r"ambient < Mf.*got ambient 60, Mf 56"):
        gymnasium.make("CaterpillarSMA-v0", randomization={"ambient_c": (20, 60)})


# In the environments

SMALL = {"physics": {"num_segments": 2, "timestep_s": 0.01}}


def conditions_of(env):
    return env.unwrapped.crawl.simulation.conditions


def test_rows_sample_and_crawl_like_single_environments():
    vector = gymnasium.make_vec(
        "CaterpillarSMASwitch-v0", num_envs=3, threads=1, randomization=RANGES, action_repeat=5, **SMALL
    )
    single = gymnasium.make(
        "CaterpillarSMASwitch-v0",
        randomization=RANGES,
        action_repeat=5,
        disable_env_checker=True,
        **SMALL,
    )
    vector.reset(seed=7)
    single.reset(seed=8)
    for values in zip(*conditions_of(vector), strict=True):
        assert len(set(values)) == 3
    actions = np.zeros((3, 4), dtype=np.int8)
    actions[:, 0] = 1
    for _ in range(6):
        many, *_ = vector.step(actions)
        one, *_ = single.step(actions[1])
    np.testing.assert_array_equal(many[1], one)
    assert conditions_of(vector)[1] == conditions_of(single)[0]


def test_every_episode_samples_anew_and_a_seed_reproduces_samples():
    env = gymnasium.make("CaterpillarSMA-v0", randomization={"friction": (0.2, 1.0)}, **SMALL)
    met = []
    for seed in (1, None, 1):
        env.reset(seed=seed)
        met += conditions_of(env)
    assert met[0] != met[1]
    assert met[2] == met[0]


def test_models_have_the_sampled_conditions():
    vector = gymnasium.make_vec(
        "CaterpillarSMA-v0", num_envs=2, threads=1, randomization={"friction": (0.2, 1.0)}, **SMALL
    )
    vector.reset(seed=0)
    models = vector.unwrapped.crawl.simulation.models
    assert all(isinstance(m, mujoco.MjModel) for m in models)
    assert [m.geom_friction[-1, 0] for m in models] == [met.friction for met in conditions_of(vector)]
