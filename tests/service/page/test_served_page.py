"""The page in a real browser: what is drawn, clicks, alarms, a restart, roles; nothing from elsewhere."""

import contextlib
import io

import matplotlib.pyplot as plt
import numpy as np
import pytest
from pages import bound, click_fibre, visitor
from served import ANN, PATIENCE_S, idle, listening, plane_of, served, wait_for

from fiberloom.service.guard.tokens import TokenFile

PLANE = plane_of()
VIEW = "v" * 32


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("page")


@pytest.fixture(scope="module")
def array(folder, browser):
    with served(folder, speed=20.0) as array:
        yield array


@pytest.fixture(scope="module")
def observed(array, folder):
    """Arms are at their targets: there is a plan to look at, a history, and a way to the folded places."""
    if array.live.plan() is None:
        array.observe(ANN, folder / "targets" / "t.csv", 0)
        idle(array)


@pytest.fixture(scope="module")
def site(array, folder):
    with listening(array, folder, bound()) as url:
        yield url


@pytest.fixture
def page(browser, array, site):
    idle(array)
    with visitor(browser, site) as page:
        page.wait_for_selector("#link:not(.off)")
        yield page
    idle(array)


def model(page, what):
    return page.evaluate(f"window.fiberloom.model.{what}")


def test_arms_are_drawn_where_the_layout_has_them(page):
    """The page's own geometry against the layout's, at angles of no symmetry."""
    rng = np.random.default_rng(3)
    angles_deg = np.column_stack([rng.uniform(0, 360, len(PLANE)), rng.uniform(0, 180, len(PLANE))])
    drawn = np.array(
        page.evaluate(
            "(a) => { const p = window.fiberloom.model.plane;"
            " return p.positioner_id.map((_, row) => p.arm(row, Float64Array.from(a))); }",
            angles_deg.T.ravel().tolist(),
        )
    )
    np.testing.assert_allclose(drawn[:, 0:2], PLANE.elbows_mm(angles_deg[:, 0]), atol=2e-3)
    np.testing.assert_allclose(drawn[:, 2:6], PLANE.beta_segments(*angles_deg.T), atol=2e-3)
    np.testing.assert_allclose(drawn[:, 6:8], PLANE.forward(*angles_deg.T), atol=2e-3)


def test_a_field_is_observed_by_a_click_and_seen_in_motion(page, array, folder):
    page.locator("#targets").select_option("t.csv")
    before = model(page, "plane.angles[0]")
    page.click("#observe")
    page.wait_for_selector("#mark:not([hidden])", timeout=1e3 * PATIENCE_S)
    assert "by the plan" in page.inner_text("#mark")
    wait_for(lambda: abs(model(page, "plane.angles[0]") - before) > 5.0)
    wait_for(lambda: "observe: done" in page.inner_text("#answer"))
    idle(array)
    shown = [model(page, f"plane.states[window.fiberloom.model.states[{k}]]") for k in range(len(PLANE))]
    assert shown.count("on_target") >= 6
    assert f"on target {shown.count('on_target')}" in page.inner_text("#legend")
    # the angles that are drawn at the end are those that are kept
    known = array.book.places(PLANE.positioner_id).angles_deg[:, 0]
    wait_for(lambda: abs(model(page, "plane.angles[0]") - known[0]) < 0.01)


def test_a_click_on_a_positioner_shows_its_history(observed, page, array):
    row = 2
    click_fibre(page, row)
    number = PLANE.positioner_id[row]
    page.wait_for_selector(f"text=positioner {number}, hole")
    text = page.inner_text("#positioner")
    assert "health: " in text
    errors = [m["error_um"] for m in array.history(int(number))["measurements"] if m["error_um"] is not None]
    assert errors
    assert all(f"{error:.2f}" in text for error in errors[:5])
    page.keyboard.press("n")
    page.wait_for_selector(f"text=positioner {PLANE.positioner_id[(row + 1) % len(PLANE)]}, hole")
    page.fill("#search", str(number))
    page.keyboard.press("Enter")
    page.wait_for_selector(f"text=positioner {number}, hole")
    page.locator("#search").blur()
    page.keyboard.press("Escape")
    page.wait_for_selector("text=Click a positioner")


def test_the_plan_is_looked_at_by_the_slider(observed, page):
    assert page.locator("#slider").is_enabled()
    page.locator("#slider").fill("0")
    page.wait_for_selector("text=by the plan, not now")
    first = page.evaluate("Array.from(window.fiberloom.model.shownAngles())")
    page.locator("#slider").fill(page.locator("#slider").get_attribute("max"))
    last = page.evaluate("Array.from(window.fiberloom.model.shownAngles())")
    assert np.abs(np.subtract(first, last)).max() > 0.01
    page.click("#live")
    page.wait_for_selector("#mark", state="hidden")


def test_park_is_stopped_by_the_button_without_a_question(observed, page, array):
    page.click("#park")
    page.click("#dialog-yes")
    page.wait_for_selector("#mark:not([hidden])", timeout=1e3 * PATIENCE_S)
    page.click("#stop")
    wait_for(lambda: page.inner_text("#array-state") == "stopped")
    idle(array)
    assert array.commands.last()[0].command == "stop"
    assert array.commands.last()[1].result == "stopped"
    page.keyboard.press("Shift+S")  # by the keyboard too
    wait_for(lambda: [c.command for c in array.commands.last()[:2]] == ["stop", "stop"])


def test_what_cannot_begin_now_is_not_offered_and_says_why(observed, page, array):
    moves = ("#observe", "#park", "#home", "#look", "#recover")
    assert all(page.locator(button).is_enabled() for button in moves)
    page.click("#park")
    page.click("#dialog-yes")
    page.wait_for_selector("#park:disabled")
    for button in moves:
        assert page.locator(button).is_disabled()
        assert page.locator(button).get_attribute("title") == "park of local runs"
    assert page.locator("#stop").is_enabled()
    idle(array)
    page.wait_for_selector("#park:enabled")
    page.evaluate("document.querySelector('#targets').replaceChildren()")
    page.evaluate("window.fiberloom.words()")
    assert page.locator("#observe").get_attribute("title") == "add a target list first"
    page.reload()
    page.wait_for_selector("#link:not(.off)")


def test_an_alarm_is_on_top_and_is_acknowledged(page, array):
    array.alarms.raise_("dark", "7", "<b>its fibre</b> is not seen")
    alarm = page.locator(".alarm.minor")
    alarm.wait_for()
    assert "<b>its fibre</b> is not seen" in alarm.inner_text()  # text, never markup
    assert "look at its light" in alarm.inner_text()
    alarm.locator(".acknowledge").click()
    page.wait_for_selector("text=seen by local")
    array.alarms.clear("dark", "7")
    alarm.wait_for(state="detached")
    assert page.locator("#alarms").bounding_box()["y"] < page.locator("main").bounding_box()["y"] + 1


def test_a_positioner_is_excluded_with_a_reason_and_included_again(page, array):
    number = int(PLANE.positioner_id[3])
    page.fill("#search", str(number))
    page.keyboard.press("Enter")
    page.click("#positioner .exclude")
    page.fill("#dialog-input", "beta slips")
    page.keyboard.press("Enter")
    page.wait_for_selector("text=beta slips")
    wait_for(lambda: "excluded 1" in page.inner_text("#legend"))
    page.click("#positioner .exclude")
    wait_for(lambda: "excluded" not in page.inner_text("#legend"))
    assert array.exclusions() == []


def test_themes_and_a_tablet(page):
    for name in ("red", "light", "dark"):
        page.locator("#theme").select_option(name)
        assert page.evaluate("document.documentElement.dataset.theme") == name
    page.locator("#theme").select_option("red")
    page.wait_for_timeout(100)
    red, green, blue, _ = page.evaluate(
        "Array.from(document.querySelector('#still').getContext('2d').getImageData(2, 2, 1, 1).data)"
    )
    assert (green, blue) == (0, 0)  # no light that harms eyes that are used to the dark
    assert red < 40
    page.locator("#errors").uncheck()
    page.wait_for_timeout(100)
    seen = plt.imread(io.BytesIO(page.screenshot()))[..., :3]
    page.locator("#errors").check()
    grey = (seen[..., 0] > 0.15) & (seen[..., 1:].max(axis=2) > 0.9 * seen[..., 0])
    assert np.argwhere(grey).tolist() == []  # also of what the browser paints by itself
    page.set_viewport_size({"width": 820, "height": 1180})
    for element in ("#stop", "#observe", "#slider", "#moving"):
        box = page.locator(element).bounding_box()
        assert 0 <= box["x"] <= box["x"] + box["width"] <= 821, element
        assert box["y"] + box["height"] <= 1181, element


def test_the_page_recovers_when_the_service_begins_again(browser, array, folder):
    sock = bound()
    port = sock.getsockname()[1]
    with listening(array, folder, sock) as url:
        opened = contextlib.ExitStack()
        page = opened.enter_context(visitor(browser, url, cut=True))
        page.wait_for_selector("#link:not(.off)")
    page.wait_for_selector("#link.off")
    assert page.inner_text("#link") == "no connection"
    assert page.inner_text("#array-state") == "not known"
    array.alarms.raise_("camera", "camera", "raised meanwhile")
    with listening(array, folder, bound(port)):
        page.wait_for_selector("#link:not(.off)", timeout=1e3 * PATIENCE_S)
        page.wait_for_selector("text=raised meanwhile")
        opened.close()
    array.alarms.clear("camera", "camera")
    array.alarms.acknowledge(array.alarms.open()[0].id, "ann")


def test_a_viewer_logs_in_and_is_offered_nothing_that_moves(browser, array, folder):
    path = folder / "tokens"
    path.write_text(f"viewer vic {VIEW}\n")
    path.chmod(0o600)
    with (
        listening(array, folder, bound(), TokenFile.read(path)) as url,
        visitor(browser, url) as page,
    ):
        page.wait_for_selector("#dialog-input")
        page.fill("#dialog-input", VIEW)
        page.keyboard.press("Enter")
        page.wait_for_selector("#link:not(.off)")
        assert page.inner_text("#who") == "vic, viewer"
        for button in ("#observe", "#park", "#home", "#recover"):
            assert page.locator(button).is_disabled(), button
        headers = {"X-Fiberloom": "1", "Origin": url}
        assert page.request.get(f"{url}/api/v1/state").status == 200  # by its cookie
        assert page.request.post(f"{url}/api/v1/park", headers=headers).status == 403
