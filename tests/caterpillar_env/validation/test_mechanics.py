from caterpillar_env.validation import mechanics


def failed(checks):
    return [check for check in checks if not check.passed]


def test_statics():
    assert not failed(mechanics.statics(quick=True))
