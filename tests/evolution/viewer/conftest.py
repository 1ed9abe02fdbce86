import pytest


@pytest.fixture(scope="module")
def server():
    viser = pytest.importorskip("viser")
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    yield server
    server.stop()


@pytest.fixture
def client(server):
    """The server in the role of a client. All clients share its scene and controls."""
    yield server
    server.scene.reset()
    server.gui.reset()
