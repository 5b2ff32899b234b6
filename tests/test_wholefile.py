"""A file is there whole or not at all."""

import errno
import os

import pytest

from fiberloom.errors import InputError
from fiberloom.wholefile import whole, write_whole


def interrupted(file):
    with whole(file) as part:
        part.write_text("half of the n")
        raise KeyboardInterrupt


def test_the_old_file_stays_where_the_new_one_is_not_finished(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("old")
    with pytest.raises(KeyboardInterrupt):
        interrupted(file)
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


def test_it_takes_its_name_at_the_end(tmp_path):
    file = tmp_path / "a.csv"
    with whole(file) as part:
        part.write_text("new")
        assert not file.exists()
        assert part.suffix == ".csv"
    assert [f.name for f in tmp_path.iterdir()] == ["a.csv"]
    write_whole(file, "µm")
    assert file.read_text(encoding="utf-8") == "µm"


def test_a_full_disk_is_named_with_the_file(tmp_path):
    file = tmp_path / "a.csv"
    with (
        pytest.raises(InputError, match=r"a\.csv: cannot be written \(No space left on device\)"),
        whole(file),
    ):
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(InputError, match=r"missing/a\.csv: cannot be written \(No such file"):
        write_whole(tmp_path / "missing" / "a.csv", "text")


def test_a_folder_or_a_device_does_not_lose_its_name(tmp_path):
    """As root a device could be replaced: /dev/full was, by trajectories."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    (tmp_path / "link").symlink_to(pipe)
    for name, why in (
        ("pipe", "it is a device or a pipe"),
        ("link", "it is a device"),
        ("", "it is a folder"),
    ):
        with pytest.raises(InputError, match=rf"cannot be written \({why}.*\); give the name of a file"):
            write_whole(tmp_path / name, "text")
    assert pipe.is_fifo()
