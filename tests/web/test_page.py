"""The page gives the same results as Python, and its controls work. It runs in Chromium.

All tests are in one file, so that one process builds the page.
"""

import contextlib
import io
import re

import mujoco
import numpy as np
import pytest

from caterpillar_env import Failure, Morphology, Physics, SmaSpring, simulate
from caterpillar_env.gait import GAIT_PERIOD_S, GaitTimings
from caterpillar_env.model import ModelBuilder
from caterpillar_env.physics import SMA_STEP_S
from caterpillar_env.sma import SmaState, advance
from caterpillar_env.task import FailureLimits, update_failures
from evolution.genome import Encoding

pytestmark = pytest.mark.slow
PAIRS, SPRINGS = 6, 4
CLOSE_M = 1e-6  # 0.001 mm, as the page says


def call(page, name, *arguments):
    return page.evaluate(f"given => caterpillar.{name}(...given)", list(arguments))


def draw_gaits(count, seed):
    rng = np.random.default_rng(seed)
    return GaitTimings(5.0, 5 * rng.random((count, PAIRS)), 5 * rng.random((count, PAIRS)))


def test_models_have_the_same_numbers(page):
    corners = [np.zeros((1, 8)), np.ones((1, 8)), np.eye(8), 1 - np.eye(8)]  # some with slack springs
    builder = ModelBuilder(Physics(), scenery=False)
    for unit in np.concatenate([np.random.default_rng(0).random((20, 8)), *corners]):
        body = Morphology.from_unit(unit)
        ours = builder.build(body)
        theirs = mujoco.MjModel.from_xml_string(call(page, "toXml", body.to_array().tolist()))
        fields = {name for name in dir(ours) if isinstance(getattr(ours, name), np.ndarray)}
        assert {"body_inertia", "jnt_stiffness", "qpos_spring", "tendon_length0"} <= fields
        for name in fields - {"ten_J_rownnz", "ten_J_colind"}:  # trimmed after compilation
            found, expected = getattr(theirs, name), getattr(ours, name)
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15, err_msg=name)


def test_fractions_follow_the_same_path(page):
    rng, spring = np.random.default_rng(1), SmaSpring()
    gait = GaitTimings(5.0, 5 * rng.random(SPRINGS), 5 * rng.random(SPRINGS)).power(SMA_STEP_S)
    on = np.ones((600, SPRINGS))  # long enough to reach the cut-off
    power = np.concatenate([np.tile(gait, (4, 1)), on, 0 * on, rng.random((500, SPRINGS))])
    expected = advance(spring, SmaState.cold(spring, (SPRINGS,)), power, SMA_STEP_S).path.fraction
    assert np.ptp(expected) == 1.0
    assert np.abs(call(page, "fractions", power.tolist()) - expected).max() < 1e-9


def test_gaits_have_the_same_power(page):
    gaits = draw_gaits(8, 2)
    for on_s, off_s, expected in zip(gaits.on_s, gaits.off_s, gaits.power(SMA_STEP_S), strict=True):
        power = call(page, "power", on_s.tolist(), off_s.tolist())
        np.testing.assert_allclose(power, expected, atol=1e-12)


def test_delays_and_duties_give_the_same_gait(page):
    gaits = draw_gaits(8, 3)
    for on_s, off_s, *expected in zip(gaits.on_s, gaits.off_s, *gaits.to_phases(), strict=True):
        phases = call(page, "toPhases", on_s.tolist(), off_s.tolist())
        np.testing.assert_allclose([phases["delay"], phases["duty"]], expected, atol=1e-12)
        times = call(page, "fromPhases", phases)
        np.testing.assert_allclose([times["onS"], times["offS"]], [on_s, off_s], atol=1e-12)


def test_pair_that_is_always_powered_gets_the_largest_duty(page):
    always = GaitTimings(GAIT_PERIOD_S, np.zeros(6), np.full(6, GAIT_PERIOD_S))
    phases = call(page, "toPhases", always.on_s.tolist(), always.off_s.tolist())
    np.testing.assert_array_equal(phases["duty"], always.to_phases()[1])


def test_wave_genomes_give_the_same_robot(page):
    genomes = np.random.default_rng(4).random((8, 12))
    bodies, timings = Encoding(timing="wave").decode(genomes)
    for row, (genome, body) in enumerate(zip(genomes, bodies, strict=True)):
        robot = call(page, "decode", genome.tolist())
        np.testing.assert_allclose(robot["body"], body.to_array(), rtol=1e-12)
        # The package decodes times in single precision, like actions.
        np.testing.assert_allclose(robot["onS"], timings.on_s[row], atol=1e-6)
        np.testing.assert_allclose(robot["offS"], timings.off_s[row], atol=1e-6)


def test_failures_have_the_same_names(page):
    rng, count = np.random.default_rng(5), 300
    posture = {
        "up": np.where(rng.random(count) < 0.7, 0.9, rng.uniform(-1, 1, count)),
        "headingRad": rng.uniform(-1, 1, count),
        "lateralM": rng.uniform(-0.15, 0.15, count),
        "clearanceM": rng.uniform(-0.01, 0.006, count),
        "bodyLoad": rng.uniform(0, 0.06, count),
        "diverged": rng.random(count) < 0.02,
    }
    up, heading_rad, lateral_m, clearance_m, body_load, diverged = posture.values()
    failures, axes = np.zeros(count, np.int8), up[:, None] * [0.0, 0.0, 1.0]
    update_failures(
        np.arange(count),
        axes,
        clearance_m,
        lateral_m,
        heading_rad,
        body_load,
        diverged,
        FailureLimits(),
        failures,
    )
    expected = [Failure(failure).label for failure in failures]
    assert set(expected) == {failure.label for failure in Failure}
    rows = [{name: values[i].item() for name, values in posture.items()} for i in range(count)]
    assert page.evaluate("rows => rows.map(caterpillar.judge)", rows) == expected


def test_winners_crawl_equally_far(page):
    winners = page.evaluate("caterpillar.winners")[::15]
    assert len(winners) == 4
    for winner in winners:
        end = call(page, "crawl", winner["robot"])
        assert end["failure"] == "ok"
        assert end["distanceM"] == pytest.approx(winner["distanceM"], abs=CLOSE_M)


def test_random_robots_crawl_equally_far(page):
    """The robots are not chaotic: a change of the body by 1e-12 moves them by less than 0.001 mm."""
    rows = np.array([0, 4, 10, 20])  # two of them sag, and one tips over
    gaits, units = draw_gaits(24, 7), np.random.default_rng(6).random((24, 8))
    bodies = [Morphology.from_unit(unit) for unit in units[rows]]
    timings = GaitTimings(5.0, gaits.on_s[rows], gaits.off_s[rows])
    expected = simulate(bodies, timings, Physics())
    labels = [Failure(failure).label for failure in expected.failure]
    assert sorted(labels) == ["ok", "sagged", "sagged", "tipped"]
    for i, body in enumerate(bodies):
        on_s, off_s = timings.on_s[i].tolist(), timings.off_s[i].tolist()
        end = call(page, "crawl", {"body": body.to_array().tolist(), "onS": on_s, "offS": off_s})
        assert end["failure"] == labels[i]
        assert end["timeS"] == pytest.approx(expected.simulated_s[i])
        assert end["distanceM"] == pytest.approx(expected.distance_m[i], abs=CLOSE_M)
        assert end["energyJ"] == pytest.approx(expected.energy_j[i], rel=1e-9)


def test_python_line_repeats_the_robot(page):
    winner = page.evaluate("caterpillar.winners[20]")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(call(page, "toPython", winner["robot"]), {})
    assert f"distance_m=array([{winner['distanceM']:.8f}])" in printed.getvalue()


def test_search_maximizes(page):
    bests = page.evaluate(
        """() => [0, 1].map((circular) => caterpillar.maximize(
            (genome) => -genome.reduce((sum, gene) => {
                const off = Math.abs(gene - (circular ? 0.98 : 0.3));
                return sum + Math.min(off, circular ? 1 - off : off) ** 2;
            }, 0), Array(8).fill(Boolean(circular)), 120, 0))"""
    )
    for best in bests:
        assert len(best) == 120
        assert best[0] < -0.05
        assert best[-1] > -1e-3


def test_link_holds_the_robot(page, visit):
    other = visit(page.evaluate("caterpillar.toLink(caterpillar.winners[5].robot)"))
    assert other.inner_text("#name") == page.evaluate("caterpillar.winners[5].name")
    other.close()


@pytest.mark.parametrize("link", ["#body=1", "#body=nothing&on=&off=", "#on=1,2,3,4,5,6", "#x", ""])
def test_damaged_link_holds_no_robot(page, link):
    assert page.evaluate("link => caterpillar.fromLink(link)", link) is None


def test_page_says_that_a_link_is_incomplete(visit):
    page = visit("#body=0.03,0.02")
    assert page.inner_text("#notice") == "The link is incomplete, so the page shows another robot."
    page.select_option("#winners", "3")
    assert page.inner_text("#name") == page.evaluate("caterpillar.winners[3].name")
    assert page.inner_text("#notice") == ""
    page.close()


def test_page_links_to_the_licences(page, address):
    href = page.get_attribute("#about a", "href")
    text = page.request.get(address + href).text()
    assert "three.js authors" in text
    assert "Apache License" in text


def test_errors_are_shown(visit):
    page = visit()
    page.evaluate("dispatchEvent(new ErrorEvent('error', { message: 'out of memory' }))")
    assert page.inner_text("#notice") == "out of memory"
    page.close()


def test_own_robot_can_be_shown_again(visit):
    page = visit()
    page.locator("#body input").first.focus()
    page.keyboard.press("Home")
    page.wait_for_function("document.querySelector('#name').textContent === 'Your robot'")
    own = page.evaluate("location.hash")
    page.select_option("#winners", "3")
    page.select_option("#winners", "-1")
    assert page.evaluate("location.hash") == own
    page.close()


def test_contacts_do_not_fill_the_memory(page):
    before, after = page.evaluate("caterpillar.readLoads(20000)")
    assert after == before


def test_link_with_a_body_out_of_bounds_is_ignored(page):
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
