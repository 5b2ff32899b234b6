"""Parameter files of SDSS: what is read, and what is refused with its line."""

import gzip

import pytest

from fiberloom.errors import InputError
from fiberloom.targets.yanny import read_yanny

HEAD = """# a comment
field 12 # with a remark
name "two words"
typedef enum { A, B } KIND;
typedef struct {
  int id;
  char name[20];
  float xy[2];
} THING;
"""


def written(path, rows):
    path.write_text(HEAD + rows)
    return path


def test_keywords_rows_and_their_lines(tmp_path):
    rows = 'thing 1 "a b" { 0.5 1.5 }\n\n# none\nTHING 2 c \\\n {3 4}\n'
    found = read_yanny(written(tmp_path / "a.par", rows))
    assert found.keywords == {"field": "12", "name": "two words"}
    assert found.structs == {"THING": ["id", "name", "xy"]}
    assert found.rows["THING"] == [
        {"id": "1", "name": "a b", "xy": ["0.5", "1.5"]},
        {"id": "2", "name": "c", "xy": ["3", "4"]},
    ]
    # a continued line has the number of its start
    assert found.lines["THING"] == [10, 13]


def test_a_packed_file_is_the_same(tmp_path):
    plain = written(tmp_path / "a.par", 'THING 1 "" {0 1}\n')
    (tmp_path / "a.par.gz").write_bytes(gzip.compress(plain.read_bytes()))
    assert read_yanny(tmp_path / "a.par.gz").rows == read_yanny(plain).rows
    assert read_yanny(plain).rows["THING"][0]["name"] == ""


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("THING 1 a {0 1", "line 10: braces { } do not match"),
        ("THING 1 a 0 1}", "line 10: braces { } do not match"),
        ("THING 1 a {0 {1}}", "line 10: braces { } do not match"),
        ("THING 1 a {0 {1}", "line 10: braces { } do not match"),
        ('THING 1 "a {0 1}', 'line 10: a double quote (") is not closed'),
        ("THING 1 a", "line 10: 2 values, structure THING has 3"),
    ],
)
def test_a_broken_row_is_named_by_its_line(tmp_path, row, words):
    with pytest.raises(InputError) as refused:
        read_yanny(written(tmp_path / "a.par", row + "\n"))
    assert str(refused.value).endswith(words)
    assert "a.par" in str(refused.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.par: no such file"):
        read_yanny(tmp_path / "none.par")
    (tmp_path / "b.par").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "c.par.gz").write_bytes(gzip.compress(b"field 1\n")[:-6])
    for name, words in (("b.par", "not a text file"), ("c.par.gz", "cannot be unpacked")):
        with pytest.raises(InputError, match=rf"{name}: {words}"):
            read_yanny(tmp_path / name)
