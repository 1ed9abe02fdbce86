import shutil

import pytest


@pytest.fixture(scope="module")
def browser():
    """Chromium without a window, that draws in three dimensions without a graphics card."""
    sync_api = pytest.importorskip("playwright.sync_api")
    names = ("chromium", "chromium-browser", "google-chrome")
    path = next(filter(None, map(shutil.which, names)), None)
    if path is None:
        pytest.skip("needs Chromium (Debian: apt install chromium)")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path,
            args=[
                "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
                "--disable-quic", "--disable-background-networking",
            ],
        )  # fmt: skip
        yield browser
        browser.close()
