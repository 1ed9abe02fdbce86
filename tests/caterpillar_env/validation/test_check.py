from caterpillar_env.validation.check import check_at_least, check_at_most, check_equal, check_near


def test_near_passes_within_and_fails_beyond_its_tolerance():
    assert check_near("x", 100.0, 104.9, "N", rel=0.05).passed
    assert not check_near("x", 100.0, 105.1, "N", rel=0.05).passed
    assert check_near("x", 0.0, 0.9, "N", abs_=1.0).passed
    assert not check_near("x", 0.0, -1.1, "N", abs_=1.0).passed


def test_limits_are_inclusive():
    assert check_at_most("x", 1.0, 1.0, "").passed
    assert not check_at_most("x", 1.0, 1.01, "").passed
    assert check_at_least("x", 0.95, 0.95, "").passed
    assert not check_at_least("x", 0.95, 0.94, "").passed


def test_nan_never_passes():
    nan = float("nan")
    assert not check_near("x", 1.0, nan, "", rel=1.0).passed
    assert not check_at_most("x", 1.0, nan, "").passed
    assert not check_at_least("x", 1.0, nan, "").passed


def test_equality():
    assert check_equal("x", "ok", "ok").passed
    assert not check_equal("x", "ok", "tipped").passed
