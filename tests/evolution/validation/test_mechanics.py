import pytest

from evolution.validation import mechanics


def failed(checks):
    return [check for check in checks if not check.passed]


def test_statics():
    assert not failed(mechanics.statics(quick=True))


@pytest.mark.slow
@pytest.mark.parametrize("group", [mechanics.rest, mechanics.symmetries])
def test_every_check_passes(group):
    assert not failed(group(quick=True))
