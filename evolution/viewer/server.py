"""Web server of the viewer on 127.0.0.1. Every browser tab has its own robot.

Pages of other sites cannot use the server through the browser: a request must name this machine as its
host, and come from a page of this server.
"""

from __future__ import annotations

import contextlib
import http
import io
import re
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import viser
import websockets.asyncio.server

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import length_m
from caterpillar_env.robot import Robot
from evolution.genome import Timing
from evolution.viewer.page import Page
from evolution.viewer.session import Session

HOST = "127.0.0.1"
_OWN_HOSTS = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d+)?", re.IGNORECASE)
_FIELD_OF_VIEW_RAD = 0.7  # vertical
_CAMERA = np.array([0.5, -2.2, 1.1])  # position relative to the robot, in robot lengths


class _LocalServer(viser.ViserServer):
    def __init__(self, port: int) -> None:
        with _checking_requests(), contextlib.redirect_stdout(io.StringIO()):  # viser prints its address
            super().__init__(HOST, port, label="Caterpillar", verbose=False)

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Return None, so that no page can open viser's tunnel to a public host."""
        return None


class Viewer:
    """The web server, used as a context manager. It runs in background threads until it is closed.

    Args:
        robot: robot with which every tab starts.
        port: port of 127.0.0.1; 0 selects a free port. If it is in use, viser takes the next free one.
        timing: sliders of the gait, see `fields_of`.

    Raises:
        CaterpillarError: the robot's gait cannot be simulated.
    """

    def __init__(self, robot: Robot, port: int, timing: Timing = "on-off") -> None:
        self._robot, self._timing = robot, timing
        self._pages: dict[int, Page] = {}  # by client id; viser's threads add and remove pages
        # viser warns if a tab is closed before it has received all messages.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
        Session(robot)  # raises if the robot cannot be simulated
        self._server = _LocalServer(port)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        camera = self._server.initial_camera
        camera.position = _CAMERA * length_m(robot.morphology, robot.physics.num_segments)
        camera.look_at, camera.fov = np.zeros(3), _FIELD_OF_VIEW_RAD
        self._server.on_client_connect(self._connect)
        self._server.on_client_disconnect(self._disconnect)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self._server.get_port()}"

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
        for page in list(self._pages.values()):
            page.close()

    def _connect(self, client: viser.ClientHandle) -> None:
        self._pages[client.client_id] = Page(client, self._robot, self._timing)
        if client.client_id not in self._server.get_clients():
            self._disconnect(client)  # the tab was closed before its page was ready

    def _disconnect(self, client: viser.ClientHandle) -> None:
        page = self._pages.pop(client.client_id, None)
        if page is not None:
            page.close()


def is_own(headers: Any) -> bool:
    """Return whether a request names this machine as its host, and comes from a page of this server.

    A page of another site can reach a server on this machine in two ways: by DNS rebinding, where the
    host name of the site resolves to this machine, or through a websocket, where the Origin header names
    the site.

    Args:
        headers: `websockets.Headers` of the request.
    """
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    own = len(hosts) == 1 and _OWN_HOSTS.fullmatch(hosts[0]) is not None
    return own and all(origin in (f"http://{hosts[0]}", f"https://{hosts[0]}") for origin in origins)


@contextlib.contextmanager
def _checking_requests() -> Iterator[None]:
    """Add `is_own` to the server that viser starts. viser has no setting for it."""
    module, started = websockets.asyncio.server, []
    serve: Any = module.serve

    def checked(*arguments: Any, process_request: Any, **settings: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            if not is_own(request.headers):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "This host or origin is refused.\n")
            return process_request(connection, request)

        started.append(True)
        return serve(*arguments, process_request=check, **settings)

    module.serve = checked  # type: ignore[misc,assignment]
    try:
        yield
    finally:
        module.serve = serve  # type: ignore[misc]
    if not started:
        raise CaterpillarError("this version of viser starts its server in another way; use viser 1.1")
