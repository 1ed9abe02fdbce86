from caterpillar_env.validation.check import at_least, at_most, near, same


def test_near_passes_within_and_fails_beyond_its_tolerance():
    assert near("x", 100.0, 104.9, "N", rel=0.05).passed
    assert not near("x", 100.0, 105.1, "N", rel=0.05).passed
    assert near("x", 0.0, 0.9, "N", abs_=1.0).passed
    assert not near("x", 0.0, -1.1, "N", abs_=1.0).passed


def test_limits_hold_on_their_side():
    assert at_most("x", 1.0, 1.0, "").passed
    assert not at_most("x", 1.0, 1.01, "").passed
    assert at_least("x", 0.95, 0.95, "").passed
    assert not at_least("x", 0.95, 0.94, "").passed


def test_nothing_passes_on_nan():
    nan = float("nan")
    assert not near("x", 1.0, nan, "", rel=1.0).passed
    assert not at_most("x", 1.0, nan, "").passed
    assert not at_least("x", 1.0, nan, "").passed


def test_same_is_equality():
    assert same("x", "ok", "ok").passed
    assert not same("x", "ok", "tipped").passed
