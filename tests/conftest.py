"""What tests of several packages need."""

import pytest


@pytest.fixture(scope="module")
def few_draws():
    """The bootstrap draws 60 times instead of thousands: its intervals have tests of their own."""
    from evolution.study import statistics

    draw = statistics.bootstrap
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            statistics, "bootstrap", lambda *args, **kwargs: draw(*args, **kwargs | {"resamples": 60})
        )
        yield


@pytest.fixture(scope="module")
def studied(tmp_path_factory, few_draws):
    """Takes the text of a TOML file, runs that study to its end from the command line; its folder."""
    from evolution import cli

    def run(toml):
        home = tmp_path_factory.mktemp("study")
        (home / "small.toml").write_text(toml)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(home)
            assert cli.main(["study", "small.toml", "--no-winners"]) == 0
        return home / "studies" / "small"

    return run
