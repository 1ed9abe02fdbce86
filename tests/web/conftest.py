import runpy
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

BUILD = Path(__file__).parents[2] / "web" / "build.py"


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format, *args):
        pass


@pytest.fixture(scope="session")
def build():
    """The names in `web/build.py`."""
    return runpy.run_path(str(BUILD))


@pytest.fixture(scope="session")
def address(build):
    """Build the page, serve its files as any web server would, and return its address."""
    if build["find_npm"]() is None:
        pytest.skip("needs a Node that Vite supports, with npm, to build the page")
    folder = build["build_page"]()
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()
    server.server_close()


@pytest.fixture(scope="module")
def visit(browser, address):
    """Return a function that opens the page, and collects errors and requests to other servers."""
    unwanted = []

    def open_page(fragment=""):
        page = browser.new_page(reduced_motion="reduce", viewport={"width": 640, "height": 480})
        page.on("pageerror", lambda error: unwanted.append(str(error)))
        page.on("request", lambda request: check(request.url))
        page.goto(address + fragment)
        page.wait_for_selector("#play:enabled", timeout=60_000)
        return page

    def check(url):
        if not url.startswith((address, "data:", "blob:")):
            unwanted.append(url)

    yield open_page
    assert unwanted == []


@pytest.fixture(scope="module")
def page(visit):
    """The page, with a robot that stands still."""
    return visit()
