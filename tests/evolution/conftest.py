import pytest

from evolution import statistics


@pytest.fixture(scope="module")
def few_draws():
    """The bootstrap draws 60 times instead of thousands: its intervals have tests of their own."""
    draw = statistics.bootstrap
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            statistics, "bootstrap", lambda *args, **kwargs: draw(*args, **kwargs | {"resamples": 60})
        )
        yield
