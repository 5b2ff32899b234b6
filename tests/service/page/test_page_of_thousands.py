"""The page with 5000 positioners in motion: what is sent and drawn is counted; a click finds its one."""

import numpy as np
import pytest
from benchmarks.page.motion import ToAndFro, standing, straight_plan
from pages import bound, click_fibre, visitor
from served import listening, plane_of, wait_for

from fiberloom.service.live import CODE, FRAME

N = 5000
COUNTER = """() => {
  window.drawing = { lines: 0, paths: 0, reset() { this.lines = this.paths = 0; } };
  const count = (of, name, what) => {
    const plain = of[name];
    of[name] = function (...how) { drawing[what]++; return plain.apply(this, how); };
  };
  for (const of of [CanvasRenderingContext2D.prototype, Path2D.prototype])
    for (const name of ["lineTo", "arc", "rect"]) count(of, name, "lines");
  for (const name of ["stroke", "fill"]) count(CanvasRenderingContext2D.prototype, name, "paths");
}"""
"""Counts lines and arcs, and the paths that are painted, from now on."""


DEAD_PIXELS = """(row) => {
  const { view, model } = fiberloom, [x, y] = model.plane.arm(row).slice(6);
  const copy = document.createElement("canvas");
  view.stale = true;
  view.draw();
  const c = copy.getContext("2d", { willReadFrequently: true }), [red, green, blue] = [255, 106, 61];
  c.drawImage(document.querySelector("#moving"), 6 - Math.round(view.px(x)), 6 - Math.round(view.py(y)));
  const at = c.getImageData(0, 0, 13, 13).data;
  let n = 0;
  for (let k = 0; k < at.length; k += 4)
    n += Math.hypot(at[k] - red, at[k + 1] - green, at[k + 2] - blue) < 40;
  return n;
}"""
"""How many pixels round a fibre have the colour of `dead`."""


@pytest.fixture(scope="module")
def motion(tmp_path_factory):
    """All in motion for minutes, a move by which nothing is planned."""
    plane, rng = plane_of(N), np.random.default_rng(1)
    ends = [np.column_stack([rng.uniform(0, 360, N), rng.uniform(20, 170, N)]) for _ in range(2)]
    folder = tmp_path_factory.mktemp("thousands")
    with standing(plane, folder) as array:
        made = ToAndFro(array, straight_plan(plane, *ends, lasts_s=600.0))
        made.begin(made.plans[0])
        made.folder = folder
        yield made


@pytest.fixture(scope="module")
def page(motion, browser):
    with listening(motion.array, motion.folder, bound()) as url, visitor(browser, url) as page:
        page.wait_for_selector("#mark:not([hidden])")
        page.evaluate(COUNTER)
        yield page


def drawn(page):
    """Lines and paths of one drawing."""
    return page.evaluate(
        "() => { drawing.reset(); fiberloom.view.draw(); return [drawing.lines, drawing.paths]; }"
    )


def fit(page):
    page.evaluate("fiberloom.view.fit()")
    drawn(page)  # what is still is drawn with it, once


def test_a_picture_has_nine_bytes_for_each_positioner(motion):
    changed, picture = motion.array.live.frame(1)
    assert (changed, len(picture)) == (-1, FRAME.size + 9 * N)


def test_in_motion_only_arms_are_drawn_two_lines_each_and_one_path_for_a_colour(page):
    fit(page)
    lines, paths = drawn(page)
    assert 2 * N <= lines <= 2 * N + 10
    assert paths <= 3 + len(CODE)


def test_what_is_still_is_drawn_when_it_changes_and_not_with_each_picture(page):
    fit(page)
    page.wait_for_timeout(300)
    still, seen = page.evaluate("[fiberloom.view.stillDrawn, fiberloom.model.time_s]")
    wait_for(lambda: page.evaluate("fiberloom.model.time_s") > seen + 1.0)
    assert page.evaluate("fiberloom.view.stillDrawn") == still


def test_near_by_only_those_in_sight_are_drawn(page):
    page.evaluate("fiberloom.view.show(2500, true)")
    drawn(page)
    lines, _ = drawn(page)
    assert 20 < lines < N / 5
    fit(page)


def lonely(plane, angles_deg):
    """The row whose fibre is farthest from all other fibres and axes."""
    tip_mm = plane.forward(*angles_deg.T)
    others_mm = np.vstack([tip_mm, plane.centres_mm])
    apart_mm = np.hypot(*(tip_mm[:, None] - others_mm[None]).transpose(2, 0, 1))
    apart_mm[np.arange(N), np.arange(N)] = np.inf
    return int(np.argmax(apart_mm.min(axis=1)))


def test_a_faulty_one_is_drawn_larger_than_its_neighbours_and_over_them(page, motion):
    """In the whole field at rest."""
    plane, live = motion.plane, motion.array.live
    live.rests(motion.plans[0].end_deg)
    page.wait_for_selector("#mark", state="hidden")
    fit(page)
    row = lonely(plane, motion.plans[0].end_deg)
    assert page.evaluate(DEAD_PIXELS, row) == 0
    live.event("dead", "does not move", int(plane.positioner_id[row]))
    wait_for(lambda: page.evaluate("(row) => fiberloom.model.states[row]", row) == CODE["dead"])
    assert page.evaluate(DEAD_PIXELS, row) > 15  # 6 of a mark as large as the others


def test_a_click_in_the_whole_field_finds_the_right_one(page, motion):
    plane = motion.plane
    motion.array.live.rests(motion.plans[0].end_deg)
    page.wait_for_selector("#mark", state="hidden")
    row = lonely(plane, motion.plans[0].end_deg)
    click_fibre(page, row)
    page.wait_for_selector(f"text=positioner {plane.positioner_id[row]}, hole {plane.hole[row]}")
