"""Requests that pages of other sites could make are refused."""

import urllib.error
import urllib.request

import pytest

from caterpillar_env.robot import wave_robot

pytest.importorskip("viser")

import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from evolution.viewer.server import Viewer


@pytest.fixture(scope="module")
def url():
    with Viewer(wave_robot(), 0) as viewer:
        yield viewer.url


def status(url, **headers):
    """HTTP status of a request for the page."""
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=20) as page:
            return page.status
    except urllib.error.HTTPError as error:
        return error.code


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ({}, 200),
        ({"Host": "localhost:9000"}, 200),  # through `ssh -L 9000:localhost:8080`
        ({"Host": "evil.example"}, 403),
        ({"Host": "127.0.0.1.evil.example"}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Host": "localhost:9000", "Origin": "http://localhost:9000"}, 200),
        ({"Host": "localhost:9000", "Origin": "http://localhost:3000"}, 403),
    ],
    ids=str,
)
def test_pages_need_this_host_and_this_origin(url, headers, expected):
    assert status(url, **headers) == expected


@pytest.mark.parametrize(
    ("origin", "allowed"), [(None, True), ("own", True), ("http://evil.example", False), ("null", False)]
)
def test_websockets_need_this_origin(url, origin, allowed):
    options = {
        "origin": url if origin == "own" else origin,
        "subprotocols": [f"viser-v{viser.__version__}"],
    }
    address = url.replace("http", "ws", 1)
    if allowed:
        connect(address, **options).close()
        return
    with pytest.raises(InvalidStatus, match="403"):
        connect(address, **options)
