"""The page as a visitor uses it."""

import re

import pytest

pytestmark = pytest.mark.slow


def test_link_holds_the_robot(page, visit):
    other = visit(page.evaluate("caterpillar.toLink(caterpillar.winners[5].robot)"))
    assert other.inner_text("#name") == page.evaluate("caterpillar.winners[5].name")
    other.close()


@pytest.mark.parametrize("link", ["#body=1", "#body=nothing&on=&off=", "#on=1,2,3,4,5,6", "#x", ""])
def test_damaged_link_holds_no_robot(page, link):
    assert page.evaluate("link => caterpillar.fromLink(link)", link) is None


def test_link_with_a_body_out_of_bounds_holds_no_robot(page):
    robot = page.evaluate("caterpillar.winners[0].robot")
    robot["body"][0] = 1.0
    assert page.evaluate("robot => caterpillar.fromLink(caterpillar.toLink(robot))", robot) is None


def test_robot_crawls_while_the_page_plays(page):
    assert page.inner_text("#time") == "0.0 s"
    page.select_option("#speed", "8")
    page.focus("#view")
    page.keyboard.press("Space")
    page.wait_for_function(
        "parseFloat(document.querySelector('#time').textContent) > 0.3", timeout=60_000
    )
    page.keyboard.press("Space")
    assert page.inner_text("#status") == "paused"
    page.keyboard.press("r")
    assert page.inner_text("#time") == "0.0 s"


def test_sliders_change_the_robot(page):
    before = page.url
    slider = page.locator("#body input").first
    slider.focus()
    page.keyboard.press("Home")
    page.wait_for_function("before => location.href !== before", arg=before)
    assert "#body=0.008," in page.url
    assert page.inner_text("#name") == "Your robot"
    page.locator("#wave input").first.focus()  # a lag of 0
    page.keyboard.press("Home")
    page.wait_for_function(
        "!location.hash.includes('NaN') && document.querySelector('#wave output').value === '0 %'"
    )
    page.locator("summary").click()
    assert page.locator("#pairs output").nth(4).inner_text() == "0 %"  # delay of the next dorsal pair


def test_search_finds_a_robot_in_workers(page):
    page.click("#search")
    page.wait_for_function(
        "/[3-9] robots/.test(document.querySelector('#progress').textContent)", timeout=90_000
    )
    page.click("#search")
    page.wait_for_function("document.querySelector('#progress').textContent.includes('stopped')")
    assert page.locator("#chart circle").count() >= 3
    assert re.search(r"the best crawls \d+ mm", page.inner_text("#progress"))


@pytest.mark.parametrize("width", [1280, 768, 390])
def test_page_fits_every_screen(page, width):
    page.set_viewport_size({"width": width, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for name in ("play", "winners", "copy-python", "search"):
        box = page.locator(f"#{name}").bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width
