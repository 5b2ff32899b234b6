"""What docs/instruments.md shows must work."""

import re
import tomllib
from pathlib import Path

import pytest

from fiberloom.errors import InputError
from fiberloom.instruments import Instrument, generate, parse_instrument

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "instruments.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, flags=re.DOTALL)


def test_the_program_prints_what_it_says(tmp_path, monkeypatch, capsys):
    (program,) = blocks("python")
    monkeypatch.chdir(tmp_path)
    exec(compile(program, "docs/instruments.md", "exec"), {})
    assert capsys.readouterr().out == "500 61 300\n"
    assert (tmp_path / "runs" / "layout" / "positioners.ecsv").is_file()


def test_an_instrument_without_a_metrology_fibre(sdssv):
    (text,) = blocks("toml")
    part = tomllib.loads(text)
    data = sdssv.model_dump(mode="json")
    data["positioner"]["points"] = part["positioner"]["points"]
    data["metrology"] |= part["metrology"]
    plane = generate(parse_instrument(data, "docs"), 0, 7)
    assert plane.carries("metrology").all()


def test_the_quoted_error_is_the_real_one(sdssv):
    data = sdssv.model_dump(mode="json")
    data["alpha"]["hard_stop_deg"] = [0.0, 360.0]
    with pytest.raises(InputError) as caught:
        parse_instrument(data, "mine.toml")
    assert str(caught.value) in " ".join(PAGE.split())


def test_every_table_of_the_model_is_explained():
    for name in Instrument.model_fields:
        assert f"`{name}`" in PAGE or f"`[{name}]`" in PAGE, name
