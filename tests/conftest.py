"""Fixtures and markers that tests of several packages use."""

from functools import cache

import numpy as np
import pytest


@cache
def can_draw():
    from caterpillar_env import Morphology, Physics
    from caterpillar_env.drawing.rendering import RenderingError, RobotRenderer, View

    renderer = RobotRenderer(Morphology(), Physics(), View(8, 8))
    try:
        renderer.draw(renderer.model.qpos0, np.full(12, 25.0))
    except RenderingError:
        return False
    renderer.close()
    return True


def pytest_runtest_setup(item):
    if item.get_closest_marker("drawing") and not can_draw():
        pytest.skip("this machine cannot draw")


@pytest.fixture(scope="module")
def few_draws():
    """The bootstrap draws 60 times instead of thousands: its intervals have tests of their own."""
    from evolution.study import statistics

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(statistics, "RESAMPLES", 60)
        yield


@pytest.fixture(scope="module")
def studied(tmp_path_factory, few_draws):
    """Takes the text of a TOML file, runs that study to its end from the command line; its folder.

    The winners are simulated again at 5 ms, which is 20 times faster than at the reference timestep.
    """
    from evolution import cli
    from evolution.study import winners

    def run(toml):
        home = tmp_path_factory.mktemp("study")
        (home / "small.toml").write_text(toml)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(winners, "REFERENCE_TIMESTEP_S", 0.005)
            patch.chdir(home)
            assert cli.main(["study", "small.toml"]) == 0
        return home / "studies" / "small"

    return run
