"""A night on the page, in a real browser: bars and fields are those of the store; buttons do as they say."""

import numpy as np
import pytest
from pages import bound, visitor
from served import PATIENCE_S, idle, listening, served_three_fields, wait_for

from fiberloom.service.last_image import KeptImage
from fiberloom.service.stamps import Stamps
from fiberloom.store import Store
from fiberloom.store.nights.book import NightBook


@pytest.fixture(scope="module")
def page(tmp_path_factory, browser):
    folder = tmp_path_factory.mktemp("night")
    with (
        served_three_fields(folder, long_s=60, short_s=20) as (array, night),
        listening(array, folder, bound(), night=night) as url,
        visitor(browser, url) as page,
    ):
        page.set_default_timeout(1000 * PATIENCE_S)
        page.array, page.folder = array, folder
        yield page


class Scaled:
    """A transform of one pixel a mm."""

    def to_px(self, xy_mm):
        return xy_mm


def row(page, field):
    return page.locator(f"#night tr:has(td:text-is('{field}'))")


def test_a_night_is_begun_changed_and_seen_to_its_end(page):
    page.get_by_role("button", name="begin night").click()
    page.get_by_role("button", name="pause").click()
    page.wait_for_selector("#night h2:has-text('paused by local')")
    row(page, "left").get_by_role("button", name="skip").click()
    page.locator("#dialog-yes").click()
    page.wait_for_selector("#night tr.is-skipped")
    row(page, "b").get_by_role("button", name="first").click()
    page.get_by_role("button", name="go on").click()
    page.wait_for_selector("#night h2:has-text('finished')")
    idle(page.array)
    with Store.read(page.folder / "store.sqlite") as store:
        book = NightBook(store, 1)
        stages = [s for s in book.stages() if ":" not in s.name]
        wait_for(lambda: len(page.evaluate("fiberloom.model.night.bars")) == len(stages))
        bars = page.evaluate("fiberloom.model.night.bars")
        for bar, stage in zip(bars, stages, strict=True):
            assert (bar["name"], bar["begin"]) == (stage.name, stage.utc_start.timestamp())
        last = {v.field: v for v in book.visits()}
        for name in ("a", "b"):
            told = row(page, name).locator("td").all_text_contents()
            assert told[1:3] == ["failed", f"{last[name].on_target}/{last[name].assigned}"]
            assert float(told[3]) == pytest.approx(last[name].rms_um, abs=0.006)
        assert [(c.author, c.command) for c in book.commands()] == [
            ("local", "pause"),
            ("local", "skip"),
            ("local", "priority"),
            ("local", "go on"),
        ]
    drawn = page.evaluate(
        "(() => { const c = document.getElementById('night-bars');"
        "return new Set(c.getContext('2d').getImageData(0, 0, c.width, c.height).data).size; })()"
    )
    assert drawn > 5  # bars and words, not an empty canvas


def test_an_alarm_of_the_night_is_on_top_and_is_acknowledged(page):
    alarm = page.locator("#alarms .alarm", has_text="field a").first
    assert "within the requirement" in alarm.text_content()
    number = int(alarm.get_attribute("data-id").removeprefix("night-"))
    alarm.get_by_role("button", name="acknowledge").click()
    wait_for(lambda: page.locator(f"[data-id=night-{number}]").count() == 0)
    with Store.read(page.folder / "store.sqlite") as store:
        kept = {a.id: a.acknowledged_by for a in NightBook(store, 1).alarms()}
    assert kept[number] == "local"


def test_a_positioner_shows_its_nights_and_the_cut_out_of_the_last_image(page):
    number, n = page.array.field.plane.positioner_id[0], len(page.array.field.plane)
    spot = np.full((n, 2), 16.0)
    stamps = Stamps(np.eye(33)[None].repeat(n, 0), np.zeros((n, 2)), spot, Scaled(), 0.0)
    page.array.live.restore(KeptImage(stamps, np.full((n, 2), np.nan), 1.8e9))
    page.fill("#search", str(number))
    page.press("#search", "Enter")
    image = page.locator("#positioner img.cutout")
    image.wait_for()
    wait_for(lambda: image.evaluate("i => i.naturalWidth") > 0)
    assert image.evaluate("i => [i.naturalWidth, i.naturalHeight]") == [264, 264]
    words = page.locator("#positioner").text_content()
    assert "last image, 2027-01-15 08:00:00 UTC" in words
    assert "nights" in words
    assert "1 a" in words or "2 a" in words or "b" in words
