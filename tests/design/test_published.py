"""Published reach and coverage of the six instruments beside those of the presets."""

import json

from fiberloom.design.published import PUBLISHED, Beside, PublishedFigure, beside


def test_all_six_agree_with_what_is_published():
    found = beside()
    assert {one.published.preset for one in found} == {"lamost", "megara", "desi", "sdssv", "moons", "pfs"}
    assert [one for one in found if not one.agrees] == []
    # reaches are put in; coverage and neighbours come out
    came_out = {"share_1_or_more", "share_3_or_more", "neighbours"}
    assert len([one for one in PUBLISHED if one.figure in came_out]) == 3


def test_a_figure_outside_is_told():
    reach = PublishedFigure("pfs", "reach_mm", 4.75, 4.75, "")
    assert Beside(reach, 4.759).agrees
    assert not Beside(reach, 4.77).agrees
    assert not Beside(reach, 4.73).agrees


def test_the_command_has_a_row_for_each(fl, monkeypatch):
    code, said, _ = fl("design", "presets", "--json")
    assert code == 0
    assert [row["source"] for row in json.loads(said)] == [one.source for one in PUBLISHED]
    far = PublishedFigure("desi", "reach_mm", 7.0, 7.0, "nowhere")
    monkeypatch.setattr("fiberloom.design.published.PUBLISHED", (far,))
    code, said, _ = fl("design", "presets")
    assert code == 1
    assert "nowhere" in said
