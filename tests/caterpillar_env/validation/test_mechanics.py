from caterpillar_env.validation import mechanics
from caterpillar_env.validation.robots import evolved_robots


def test_statics():
    assert not [check for check in mechanics.check_statics() if not check.passed]


def test_failures_are_distinguished_and_healthy_robots_do_not_fail():
    assert not [check for check in mechanics.check_failures(evolved_robots(2)) if not check.passed]
