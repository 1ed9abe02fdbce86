import pytest


@pytest.fixture(scope="module")
def server():
    viser = pytest.importorskip("viser")
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    yield server
    server.stop()


@pytest.fixture
def page(server):
    """A server that stands for a page: its scene and controls are shown to every client."""
    yield server
    server.scene.reset()
    server.gui.reset()
