import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from caterpillar_env import GaitTimings
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import MAX_DUTY, count_steps, pair_names, spring_names

PERIOD_S = 3.0
TIMES = st.floats(0, PERIOD_S)


def shares(on_s, off_s, period_s=1.0, step_s=0.1):
    """Return the power of one spring over a period."""
    return GaitTimings(period_s, [on_s], [off_s]).power(step_s)[:, 0]


def test_springs_are_named_gap_by_gap_from_the_head():
    assert spring_names(2) == [
        "gap1_dorsal_left",
        "gap1_dorsal_right",
        "gap1_ventral_left",
        "gap1_ventral_right",
    ]
    assert spring_names(4)[4] == "gap2_dorsal_left"
    assert len(spring_names(4)) == 12
    assert pair_names(3) == ["gap1_dorsal", "gap1_ventral", "gap2_dorsal", "gap2_ventral"]


def test_mirrored_timings_follow_the_order_of_the_springs():
    springs = GaitTimings(1.0, [0.1, 0.2], [0.3, 0.4]).mirrored()
    assert springs.on_s.tolist() == [0.1, 0.1, 0.2, 0.2]
    assert springs.off_s.tolist() == [0.3, 0.3, 0.4, 0.4]


def test_power_is_on_between_the_times_and_fractional_in_partial_steps():
    np.testing.assert_allclose(
        shares(0.15, 0.42), [0, 0.5, 1, 1, 0.2, 0, 0, 0, 0, 0], atol=1e-12, rtol=0
    )


def test_power_wraps_around_the_end_of_the_period():
    np.testing.assert_allclose(
        shares(0.75, 0.12), [1, 0.2, 0, 0, 0, 0, 0, 0.5, 1, 1], atol=1e-12, rtol=0
    )


def test_on_and_off_within_one_step_add_up():
    np.testing.assert_allclose(shares(0.12, 0.15)[:3], [0, 0.3, 0], atol=1e-12)
    np.testing.assert_allclose(shares(0.15, 0.12)[:3], [1, 0.7, 1], atol=1e-12)


@pytest.mark.parametrize("at", [0.0, 0.37, 1.0])
def test_equal_times_mean_never_on(at):
    assert not shares(at, at).any()


def test_full_period_means_always_on():
    np.testing.assert_allclose(shares(0.0, 1.0), 1, rtol=1e-12)


def test_on_at_the_end_and_off_at_the_start_means_never_on():
    assert not shares(1.0, 0.0).any()


@settings(deadline=None)
@given(TIMES, TIMES)
def test_mean_power_is_the_duty(on_s, off_s):
    power = shares(on_s, off_s, PERIOD_S, 0.01)
    duty = (off_s - on_s) / PERIOD_S + (1 if off_s < on_s else 0)
    assert power.shape == (300,)
    assert power.min() >= 0
    assert power.max() <= 1
    assert power.mean() == pytest.approx(duty, abs=1e-12)


@settings(deadline=None)
@given(st.lists(TIMES, min_size=2, max_size=8), st.lists(TIMES, min_size=2, max_size=8))
def test_springs_are_independent(on, off):
    springs = min(len(on), len(off))
    together = GaitTimings(PERIOD_S, on[:springs], off[:springs]).power(0.1)
    for i in range(springs):
        np.testing.assert_array_equal(together[:, i], shares(on[i], off[i], PERIOD_S, 0.1))


def test_robots_are_leading_axes():
    on, off = np.array([[0.1, 0.2], [0.3, 0.9]]), np.array([[0.5, 0.1], [0.3, 1.0]])
    both = GaitTimings(1.0, on, off).power(0.05)
    assert both.shape == (2, 20, 2)
    for row in range(2):
        np.testing.assert_array_equal(both[row], GaitTimings(1.0, on[row], off[row]).power(0.05))


def test_action_range_maps_to_the_gait_period():
    timings = GaitTimings.from_action(np.array([-1.0, 1.0, 0.0, 0.5]), PERIOD_S)
    assert timings.on_s.tolist() == [0.0, 1.5]
    assert timings.off_s.tolist() == [3.0, 2.25]


@settings(deadline=None)
@given(st.lists(st.floats(-1, 1, width=32), min_size=1, max_size=6).map(lambda v: v + v[::-1]))
def test_action_round_trips_through_timings(values):
    action = np.array(values, dtype=np.float32)
    back = GaitTimings.from_action(action, PERIOD_S).to_action()
    assert back.dtype == np.float32
    assert back.shape == action.shape
    np.testing.assert_allclose(back, action, rtol=0, atol=1e-7)


def test_actions_of_many_robots_round_trip():
    action = np.linspace(-1, 1, 24, dtype=np.float32).reshape(2, 12)
    timings = GaitTimings.from_action(action, PERIOD_S)
    assert timings.on_s.shape == (2, 6)
    np.testing.assert_allclose(timings.to_action(), action, rtol=0, atol=1e-7)


@pytest.mark.parametrize("bad", [-0.001, 3.001, np.nan, np.inf])
@pytest.mark.parametrize("name", ["on_s", "off_s"])
def test_times_outside_the_period_are_rejected(name, bad):
    times = {"on_s": [0.0, 1.0], "off_s": [1.0, 2.0], name: [0.5, bad]}
    with pytest.raises(CaterpillarError, match=rf"{name} must lie in \[0, 3\] s"):
        GaitTimings(PERIOD_S, **times)


def test_different_shapes_are_rejected():
    with pytest.raises(CaterpillarError, match=r"\(2,\) and \(3,\)"):
        GaitTimings(PERIOD_S, [0, 0], [0, 0, 0])
    with pytest.raises(CaterpillarError, match="the same shape"):
        GaitTimings.from_action(np.zeros(5), PERIOD_S)


@pytest.mark.parametrize("period_s", [0.0, -1.0, np.nan, np.inf])
def test_period_must_be_positive(period_s):
    with pytest.raises(CaterpillarError, match="period_s"):
        GaitTimings(period_s, [0.0], [0.0])


def test_nan_action_is_rejected():
    with pytest.raises(CaterpillarError, match="nan"):
        GaitTimings.from_action(np.array([0.0, np.nan]), PERIOD_S)


def test_timings_copy_their_times_and_make_them_read_only():
    on = np.array([0.5])
    timings = GaitTimings(PERIOD_S, on, [1.0])
    on[0] = 2.0
    assert timings.on_s[0] == 0.5
    with pytest.raises(ValueError, match="read-only"):
        timings.on_s[0] = 1.0


def test_period_must_be_a_multiple_of_the_step():
    with pytest.raises(
        CaterpillarError, match=r"the gait period of 1 s must be a whole multiple of 0\.3 s"
    ):
        shares(0.0, 0.5, step_s=0.3)


def test_count_steps_tolerates_rounding_errors():
    assert count_steps(0.3, 0.1, "it") == 3  # 0.1 * 3 is not 0.3
    assert count_steps(30.0, 0.01, "it") == 3000


@pytest.mark.parametrize(("duration_s", "step_s"), [(0.05, 0.1), (0.0, 0.1), (-0.1, 0.1), (0.25, 0.1)])
def test_count_steps_rejects_zero_and_fractional_counts(duration_s, step_s):
    with pytest.raises(CaterpillarError, match="whole multiple"):
        count_steps(duration_s, step_s, "it")


@pytest.mark.parametrize("springs", [False, True])
def test_phases_of_a_gait_give_the_same_gait(springs):
    rng = np.random.default_rng(0)
    delay, duty = rng.random((3, 12)), rng.uniform(0.0, MAX_DUTY, (3, 12))
    gait = GaitTimings.from_phases(delay, duty, 4.0, springs=springs)
    found_delay, found_duty = gait.to_phases(springs=springs)
    assert found_delay == pytest.approx(delay, abs=1e-12)
    assert found_duty == pytest.approx(duty, abs=1e-12)


def test_spring_that_is_always_powered_gets_the_largest_duty():
    always = GaitTimings(5.0, np.array([0.0, 1.0]), np.array([5.0, 1.0]))
    assert always.to_phases()[1].tolist() == [MAX_DUTY, 0.0]


def test_delays_count_from_the_gap_ahead_and_from_the_dorsal_pair():
    gait = GaitTimings.from_phases(np.array([0.1, 0.5, 0.2, 0.9]), np.full(4, 0.25), 10.0)
    assert gait.on_s == pytest.approx([1.0, 6.0, 3.0, 2.0])
    assert gait.off_s == pytest.approx([3.5, 8.5, 5.5, 4.5])
