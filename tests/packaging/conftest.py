from functools import partialmethod

import pytest

from caterpillar_env import Physics


@pytest.fixture
def coarse(monkeypatch):
    """Set the default timestep to 10 ms, so that a simulation takes a third of the time."""
    monkeypatch.setattr(Physics, "__init__", partialmethod(Physics.__init__, timestep_s=0.01))
