"""Fixtures and markers that tests of several packages use."""

import shutil
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


@pytest.fixture(scope="module")
def browser():
    """Chromium without a window, that draws in three dimensions without a graphics card."""
    sync_api = pytest.importorskip("playwright.sync_api")
    names = ("chromium", "chromium-browser", "google-chrome")
    path = next(filter(None, map(shutil.which, names)), None)
    if path is None:
        pytest.skip("needs Chromium (Debian: apt install chromium)")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path,
            args=[
                "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
                "--disable-quic", "--disable-background-networking",
            ],
        )  # fmt: skip
        yield browser
        browser.close()
