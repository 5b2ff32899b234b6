"""Films of plans: what is shown at which moment, how large and in which colour; files whole or not at all."""

import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb
from PIL import Image

from fiberloom._core import geometry
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, generate
from fiberloom.planning import Plan, PlanSettings, Trajectory, plan, random_pair, verify
from fiberloom.planning.obstacles import parts_of
from fiberloom.report.film import film, moments
from fiberloom.report.film.film import Picture, film_title, write_film
from fiberloom.report.film.formats import require_film
from fiberloom.report.film.moments import FEWEST, FINER, MOST, NEAR_MM, Moments


def nothing(done, total):
    pass


@pytest.fixture(scope="module")
def moved(patch):
    """37 positioners from one random field to another, and what the verifier says."""
    start_deg, goal_deg = random_pair(patch, 0)
    made = plan(patch, start_deg, goal_deg)
    assert made.refused == {}
    return Moments(patch, made, goal_deg), start_deg, verify(patch, made, goal_deg=goal_deg)


@pytest.fixture(scope="module")
def stuck(sdssv):
    """37 positioners: some overlap at their start for the wide buffer, one is offline."""
    plane = generate(sdssv, 0, 37)
    start_deg, goal_deg = random_pair(plane, 0)
    plane = plane.with_offline([int(plane.positioner_id[5])], start_deg[[5]])
    made = plan(plane, start_deg, goal_deg, settings=PlanSettings(collision_buffer_mm=2.3))
    assert made.refused
    return Moments(plane, made, goal_deg), verify(plane, made)


@pytest.fixture
def brief(monkeypatch, sdssv):
    """Seven positioners; four pictures, the last one three times."""
    monkeypatch.setattr(moments, "FEWEST", 3)
    monkeypatch.setattr(moments, "MOST", 3)
    monkeypatch.setattr(film, "LAST_S", 0.2)
    plane = generate(sdssv, 0, 7)
    goal_deg = plane.park_deg - [-20.0, 40.0]
    return Moments(plane, plan(plane, plane.park_deg, goal_deg), goal_deg)


def still(plane):
    robots = tuple(Trajectory(int(p), np.zeros(1), *plane.park_deg[[0]].T) for p in plane.positioner_id)
    return Plan(plane.instrument.name, plane.collision_buffer_mm, robots)


# moments


def test_pictures_begin_at_the_start_and_end_at_the_goal(moved):
    shown, start_deg, _ = moved
    first, last = shown.pictures[[0, -1]]
    assert shown.time_s[last] == shown.plan.duration_s
    np.testing.assert_allclose(shown.angles_deg[first], start_deg, atol=1e-8)
    np.testing.assert_allclose(shown.angles_deg[last], shown.goal_deg, atol=1e-8)
    # the approach is the last of every motion
    ends_s = np.array([robot.time_s[-1] for robot in shown.plan.robots])
    over = shown.time_s[:, None] >= ends_s
    np.testing.assert_array_equal(shown.arrived, over)
    assert 0 < over[last - 1].sum() < 37
    assert not shown.moving[over].any()
    assert shown.moving[last - 1][~over[last - 1]].all()
    assert 0 < shown.moving.sum(axis=1).min(initial=37, where=shown.time_s < 5.0) < 37


@pytest.mark.parametrize(("duration_s", "steps"), [(1.125, FEWEST), (30.0, 100), (900.0, MOST)])
def test_a_film_has_as_many_pictures_as_its_motion_is_long(moved, duration_s, steps):
    shown = moved[0]
    times = np.array([0.0, duration_s])
    first = shown.plan.robots[0]
    robot = replace(first, time_s=times, alpha_deg=times, beta_deg=times)
    long = replace(shown, plan=replace(shown.plan, robots=(robot,)))
    assert len(long.pictures) == steps + 1
    assert len(long.time_s) == steps * FINER + 1


def test_without_motion_there_is_one_picture(sdssv):
    plane = generate(sdssv, 0, 3)
    shown = Moments(plane, still(plane), plane.park_deg)
    assert (len(shown.pictures), shown.moving.any(), shown.arrived.all()) == (1, False, True)


def test_the_least_gap_is_the_verifiers_but_for_sampling(moved):
    shown, _, checked = moved
    least_mm = shown.least_gap_mm.min()
    # two arms close in by at most 0.2 mm in the 0.04 s of half a sample, near the least far less
    assert checked.min_clearance_mm - 1e-4 < least_mm < checked.min_clearance_mm + 0.05


def gaps_beyond_buffers_mm(shown, moment):
    """(N, N + K) between all bodies, one pair at a time; inf of a body to itself."""
    lines = shown.plane.beta_segments(*shown.angles_deg[moment].T)
    radius, n = shown.plan.collision_buffer_mm, shown.plane.n
    obstacles = shown.bodies.obstacles
    others = np.vstack([lines, obstacles[:, :4]])
    radii = np.concatenate([np.full(n, radius), obstacles[:, 4]])
    gaps = np.array([geometry.segment_distance(np.tile(mine, (len(others), 1)), others) for mine in lines])
    gaps -= radius + radii
    gaps[np.arange(n), np.arange(n)] = np.inf
    return gaps


def test_arms_that_are_near_are_marked_and_the_least_gap_is_of_all_bodies(moved):
    shown, at_obstacle = moved[0], 0
    n = shown.plane.n
    for moment in shown.pictures[::5]:
        gaps = gaps_beyond_buffers_mm(shown, moment)
        close = gaps < NEAR_MM
        expected = close.any(axis=0)
        expected[:n] |= close.any(axis=1)
        np.testing.assert_array_equal(shown.near[moment], expected)
        assert shown.least_gap_mm[moment] == pytest.approx(gaps.min(), abs=1e-9)
        at_obstacle += gaps[:, n:].min() < gaps[:, :n].min()
    assert shown.near.any()
    assert at_obstacle  # or they are not looked at


def test_the_nearest_two_are_named(moved, stuck):
    shown, n = moved[0], moved[0].plane.n
    for moment in shown.pictures[::5]:
        gaps = gaps_beyond_buffers_mm(shown, moment)
        one, other = sorted(np.unravel_index(gaps.argmin(), gaps.shape))
        said = shown.nearest(int(moment))
        assert said.endswith(f", {gaps.min():.3f} mm")
        names = {str(shown.plane.positioner_id[k]) for k in (one, other) if k < n}
        assert names <= set(said.replace(",", "").split())
        if other >= n:
            assert "fiducial" in said or "guide camera" in said
    # two that overlap and stay are not what the motion comes nearest to
    touching = {v.positioner_id for v in stuck[1].contacts}
    assert str(min(touching)) not in stuck[0].nearest(0).replace(",", "").split()


def test_pairs_that_overlap_and_stay_do_not_hide_the_least_gap(stuck):
    shown, checked = stuck
    assert checked.min_clearance_mm < 0.0
    assert shown.least_gap_mm.min() > 0.0
    touching = {v.positioner_id for v in checked.contacts}
    assert set(shown.plane.positioner_id[shown.near[0, : shown.plane.n]]) >= touching


def test_an_offline_positioner_is_where_the_plane_says(stuck):
    shown = stuck[0]
    assert not shown.moving[:, 5].any()
    assert not shown.arrived[:, 5].any()
    np.testing.assert_array_equal(shown.angles_deg[-1, 5], shown.plane.offline_position_deg[5])


# pictures


def test_the_title_says_the_result(moved, stuck, sdssv):
    shown, _, checked = moved
    gap = f"least gap {checked.min_clearance_mm:.3f} mm beyond the buffer"
    assert (
        film_title(shown, checked)
        == f"37 positioners, {shown.plan.duration_s:.1f} s of motion, {gap}, verified"
    )
    kept, found = stuck
    n = 37 - len(kept.plan.refused)
    assert film_title(kept, found).startswith(f"{n} of 37 positioners arrive, ")
    assert f"{len(found.contacts)} pairs overlap and stay" in film_title(kept, found)
    fast = replace(shown.plan, robots=tuple(replace(r, time_s=r.time_s / 3) for r in shown.plan.robots))
    assert film_title(shown, verify(shown.plane, fast)).endswith("NOT VERIFIED")
    alone = generate(sdssv, 0, 1)
    alone = replace(alone, fiducials=alone.fiducials[:0], guide_cameras=alone.guide_cameras[:0])
    none = Moments(alone, still(alone), alone.park_deg)
    assert none.nearest(0) == ""
    assert "no neighbours" in film_title(none, verify(alone, none.plan))
    Picture(none, "nothing but one arm").figure.canvas.draw()


def px_per_mm(axes):
    (left, _), (right, _) = axes.transData.transform([[0.0, 0.0], [1.0, 0.0]])
    (_, low), (_, high) = axes.transData.transform([[0.0, 0.0], [0.0, 1.0]])
    assert right - left == pytest.approx(high - low, rel=1e-9)
    return right - left


def test_buffers_obstacles_and_arms_are_drawn_to_scale(moved):
    shown = moved[0]
    picture = Picture(shown, "title")
    pt_per_mm = px_per_mm(picture.field) * 72.0 / picture.figure.dpi
    assert picture.buffers.get_linewidths() == pytest.approx([4.0 * pt_per_mm] * shown.plane.n)
    np.testing.assert_allclose(
        np.sqrt(picture.fiducials.get_sizes()), 2.0 * shown.plane.fiducials[:, 2] * pt_per_mm
    )
    np.testing.assert_allclose(
        picture.others.get_linewidths(), 2.0 * shown.plane.guide_cameras[:, 4] * pt_per_mm
    )
    moment = int(shown.pictures[40])
    picture.show(moment)
    alpha_deg, beta_deg = shown.angles_deg[moment].T
    ends = np.stack([shown.plane.centres_mm, shown.plane.elbows_mm(alpha_deg)], axis=1)
    np.testing.assert_allclose(picture.alpha_arms.get_segments(), ends)
    lines = shown.plane.beta_segments(alpha_deg, beta_deg).reshape(-1, 2, 2)
    np.testing.assert_allclose(picture.beta_arms.get_segments(), lines)
    np.testing.assert_allclose(picture.buffers.get_segments(), lines)
    # everything an arm reaches is inside
    left, right = picture.field.get_xlim()
    assert left < lines[..., 0].min() - 2.0 < lines[..., 0].max() + 2.0 < right


def test_all_parts_of_arms_and_keep_outs_are_drawn():
    """DESI: ten capsules an arm, on both axes; the edges of the petals."""
    plane = FocalPlane.of("desi", n=37)
    start_deg, goal_deg = random_pair(plane, 0)
    shown = Moments(plane, plan(plane, start_deg, goal_deg), goal_deg)
    picture = Picture(shown, "title")
    moment = int(shown.pictures[10])
    picture.show(moment)
    pt_per_mm = px_per_mm(picture.field) * 72.0 / picture.figure.dpi
    radii = parts_of(plane, plane.collision_buffer_mm)[:, 6]
    assert len(set(radii)) > 5
    drawn = np.array(picture.buffers.get_segments())
    assert len(drawn) == len(radii) == 10 * plane.n
    np.testing.assert_allclose(picture.buffers.get_linewidths(), np.maximum(2.0 * radii * pt_per_mm, 0.8))
    # parts lie along their arm: alpha from its axis to the elbow, beta from there to the fibre
    alpha_deg, beta_deg = shown.angles_deg[moment].T
    axis, elbow = plane.centres_mm[3], plane.elbows_mm(alpha_deg)[3]
    near, far = plane.beta_segments(alpha_deg, beta_deg)[3].reshape(2, 2)
    for k, part in enumerate(parts_of(plane, plane.collision_buffer_mm)[:10]):
        origin, along = (elbow, far - near) if part[1] else (axis, elbow - axis)
        turn = np.array([along, [-along[1], along[0]]]) / np.hypot(*along)
        np.testing.assert_allclose(drawn[30 + k], origin + part[2:6].reshape(2, 2) @ turn, atol=1e-6)
    edges = np.vstack([keep_out.capsules_mm for keep_out in plane.instrument.bodies.keep_outs])
    np.testing.assert_allclose(np.array(picture.others.get_segments()).reshape(-1, 4), edges[:, :4])
    legend = {text.get_text() for text in picture.figure.legends[0].get_texts()}
    assert any("keep-out" in line for line in legend)


def test_colours_say_who_moves_who_is_near_and_who_does_not_arrive(stuck):
    shown = stuck[0]
    picture, moment = Picture(shown, "title"), int(shown.pictures[20])
    picture.show(moment)
    drawn = np.array([to_hex(c) for c in picture.beta_arms.get_colors()])
    plain = ~shown.refused & ~shown.plane.offline
    assert set(drawn[shown.refused]) == {film.REFUSED}
    assert set(drawn[shown.plane.offline]) == {film.OFFLINE}
    assert set(drawn[plain & shown.moving[moment]]) == {film.MOVING}
    arrived = plain & shown.arrived[moment]
    assert set(drawn[arrived]) == {film.ARRIVED}
    assert set(drawn[plain & ~shown.moving[moment] & ~arrived]) == {film.RESTING}
    halo = np.array([to_hex(c) for c in picture.buffers.get_colors()])
    np.testing.assert_array_equal(halo == film.NEAR, shown.near[moment, : shown.plane.n])
    assert set(halo[shown.refused]) == {film.NEAR, film.STRANDED}
    names = {text.get_text() for text in picture.field.texts}
    assert names >= {str(p) for p in shown.plan.refused}
    legend = {text.get_text() for text in picture.figure.legends[0].get_texts()}
    assert legend >= {"does not arrive", "offline", "in motion", "at its goal"}
    # a goal is filled once it is reached; who is offline has none
    assert {to_hex(c) for c in picture.goals.get_facecolor()[~arrived]} == {"#ffffff"}
    assert np.ma.getmaskarray(picture.goals.get_offsets()).all(axis=1).nonzero()[0].tolist() == [5]
    picture.show(int(shown.pictures[-1]))
    filled = np.array([to_hex(c) for c in picture.goals.get_facecolor()]) == film.ARRIVED
    np.testing.assert_array_equal(filled, plain)


def test_obstacles_that_arms_come_near_are_marked(moved):
    shown = moved[0]
    obstacles = shown.near[:, shown.plane.n :]
    moment = int(shown.pictures[obstacles[shown.pictures].sum(axis=1).argmax()])
    assert obstacles[moment].any()
    picture = Picture(shown, "title")
    picture.show(moment)
    colours = [*picture.fiducials.get_facecolors(), *picture.others.get_colors()]
    expected = np.where(obstacles[moment], film.NEAR, film.OBSTACLE)
    assert [to_hex(c) for c in colours] == expected.tolist()


def test_the_clock_runs(moved):
    picture, shown = Picture(moved[0], "title"), moved[0]
    moment = int(shown.pictures[30])
    picture.show(moment)
    time_s = shown.time_s[moment]
    first, second = picture.clock.get_text().splitlines()
    assert first == f"{time_s:.1f} s   {shown.moving[moment].sum()} in motion"
    assert second == shown.nearest(moment)
    assert [line.get_xdata()[0] for line in picture.now] == [time_s, time_s]


# files


def area_px(path, number, colour):
    """How much of the field has this colour in a picture of the film."""
    with Image.open(path) as image:
        image.seek(number % image.n_frames)
        field = np.asarray(image.convert("RGB"))[100:780]
    return (field == np.rint(255 * np.array(to_rgb(colour)))).all(axis=2).sum()


def test_a_gif_has_all_pictures_and_ends_with_arms_at_their_goals(brief, tmp_path):
    path, told = tmp_path / "film.gif", []
    write_film(path, brief, "seven", lambda done, total: told.append((done, total)))
    assert told == [(k, 6) for k in range(1, 7)]
    with Image.open(path) as image:
        assert image.size == tuple(round(s * film.DPI) for s in film.SIZE_IN)
        shown_ms = []
        for k in range(image.n_frames):
            image.seek(k)
            shown_ms.append(image.info["duration"])
            assert image.convert("RGB").getpixel((0, 0)) == (255, 255, 255)
    assert sum(shown_ms) == 6 * 1000 / film.PICTURES_PER_S
    # all move in the first picture and are at their goals in the last
    assert area_px(path, 0, film.MOVING) > 1000
    assert area_px(path, -1, film.MOVING) == 0
    first, last = (area_px(path, k, film.ARRIVED) for k in (0, -1))
    assert first == 0
    assert last > 1000


def test_a_film_that_is_given_up_leaves_the_old_one(brief, tmp_path):
    path = tmp_path / "film.gif"
    path.write_bytes(b"old")

    def stopped(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_film(path, brief, "seven", stopped)
    assert [p.name for p in tmp_path.iterdir()] == ["film.gif"]
    assert path.read_bytes() == b"old"
    with pytest.raises(InputError, match=r"nowhere.film\.gif: cannot be written"):
        write_film(tmp_path / "nowhere" / "film.gif", brief, "seven", nothing)


FFMPEG = '#!/bin/sh\nfor last; do :; done\ncat > "$last"\n'
FAILING = "#!/bin/sh\ncat > /dev/null\necho first >&2\necho 'no space left' >&2\nexit 1\n"


def program(folder, text):
    folder.mkdir()
    path = folder / "ffmpeg"
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return folder


def test_an_mp4_gets_every_picture_through_ffmpeg(brief, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(program(tmp_path / "bin", FFMPEG)), prepend=":")
    write_film(tmp_path / "film.mp4", brief, "seven", nothing)
    width, height = (round(s * film.DPI) for s in film.SIZE_IN)
    assert (width % 2, height % 2) == (0, 0)
    assert (tmp_path / "film.mp4").stat().st_size == 6 * width * height * 4


def test_what_ffmpeg_complains_of_is_told_in_a_line(brief, tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("PATH", str(program(tmp_path / "bin", FAILING)), prepend=":")
    with pytest.raises(InputError, match=r"film\.mp4: cannot be written \(ffmpeg: no space left\)$"):
        write_film(tmp_path / "film.mp4", brief, "seven", nothing)
    assert [p.name for p in tmp_path.iterdir()] == ["bin"]
    assert caplog.records == []


def test_names_that_no_film_can_have(tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"--animate a\.avi: a film is a \.gif or a \.mp4 file"):
        require_film("--animate", Path("a.avi"))
    (tmp_path / "d.gif").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        require_film("--animate", tmp_path / "d.gif")
    monkeypatch.setenv("PATH", str(tmp_path))
    require_film("--animate", tmp_path / "A.GIF")
    with pytest.raises(InputError, match=r"needs ffmpeg, .* install it, or write a \.gif"):
        require_film("--animate", tmp_path / "a.mp4")
    monkeypatch.setenv("PATH", str(program(tmp_path / "bin", FFMPEG)))
    require_film("--animate", tmp_path / "a.mp4")
