import pytest


@pytest.fixture
def page():
    """A server that stands for a page: its scene and panel are those of whoever opens it."""
    viser = pytest.importorskip("viser")
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    yield server
    server.stop()
