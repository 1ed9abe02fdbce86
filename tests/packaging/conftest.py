from functools import partialmethod

import pytest

from caterpillar_env import Physics


@pytest.fixture
def coarse(monkeypatch):
    """The timestep is 10 ms where code does not set it: a simulation takes a third of the time."""
    monkeypatch.setattr(Physics, "__init__", partialmethod(Physics.__init__, timestep_s=0.01))
