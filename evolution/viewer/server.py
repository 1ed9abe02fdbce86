"""Serves the page on loopback: every tab that opens it has a robot of its own."""

from __future__ import annotations

import contextlib
import io
import socket
import threading
import warnings

import numpy as np
import viser

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import length_m, segments_of
from caterpillar_env.robot import Robot
from evolution.viewer.player import Player
from evolution.viewer.session import Session

HOST = "127.0.0.1"
_FIELD_OF_VIEW_RAD = 0.7  # vertical
_WIDEST = 0.75  # width over height of what the panels leave of a common window
_BEHIND_SHEET = 0.3  # of a narrow page's height, by which its panel at the bottom pushes the robot up


class _LocalServer(viser.ViserServer):
    def request_share_url(self, verbose: bool = True) -> str | None:
        """None: viser would open a tunnel to a public host when a page asks for it."""
        return None


class Viewer:
    """The server. It runs in threads of its own until it is left.

    Args:
        individual: the robot that every tab begins with.
        port: of 127.0.0.1 to listen on; 0 is any free one.

    Raises:
        CaterpillarError: the port cannot be had, or the robot's gait cannot be run.
    """

    def __init__(self, individual: Robot, port: int) -> None:
        self._individual = individual
        self._players: dict[int, Player] = {}
        self._lock = threading.Lock()
        # Frames that a tab did not wait for when it was closed.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
        Session(individual)  # that it can be run is better found out now than in a page
        _check_port(port)
        with contextlib.redirect_stdout(io.StringIO()):  # viser says where it listens; so do we
            self._server = _LocalServer(HOST, port, label="Caterpillar", verbose=False)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        camera = self._server.initial_camera
        camera.position, camera.look_at = _view(individual, _WIDEST)
        camera.fov = _FIELD_OF_VIEW_RAD
        self._server.on_client_connect(self._opened)
        self._server.on_client_disconnect(self._left)

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self._server.get_port()}"

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
        with self._lock:
            players = list(self._players.values())
            self._players.clear()
        for player in players:
            player.close()

    def _opened(self, client: viser.ClientHandle) -> None:
        aspect = client.camera.image_width / max(client.camera.image_height, 1)
        if aspect < _WIDEST:
            client.camera.position, client.camera.look_at = _view(self._individual, aspect)
        player = Player(client, self._individual)
        with self._lock:
            self._players[client.client_id] = player
        if client.client_id not in self._server.get_clients():
            self._left(client)  # it went before its robot was ready

    def _left(self, client: viser.ClientHandle) -> None:
        with self._lock:
            player = self._players.pop(client.client_id, None)
        if player is not None:
            player.close()


def _view(individual: Robot, aspect: float) -> tuple[Array, Array]:
    """Where the camera stands and what it looks at, so that the robot fills a page, m."""
    physics = individual.physics
    long_m = length_m(segments_of(individual.morphology, physics.num_segments))
    height_m = 1.35 * long_m / aspect  # that is seen at the robot
    look_at = np.array([0.0, 0.0, 0.015 - (_BEHIND_SHEET * height_m if aspect < _WIDEST else 0.0)])
    direction = np.array([0.2, -0.88, 0.43])
    return look_at + direction * height_m / (2 * np.tan(_FIELD_OF_VIEW_RAD / 2)), look_at


def _check_port(port: int) -> None:
    """See that the port can be had: viser takes the next one without a word.

    Raises:
        CaterpillarError: it cannot.
    """
    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((HOST, port))
    except (OSError, OverflowError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not in 0 to 65535"
        raise CaterpillarError(
            f"cannot listen on port {port} of {HOST}: {reason}; choose another with --port, or 0 "
            "for any free one"
        ) from None
