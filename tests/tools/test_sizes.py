"""Functions, parameters and files stay within the limits of the house, counted as `make figures` counts."""

import pytest

from tools.layout import LANGUAGES, ROOT, files_below, group_of
from tools.tree import MAX_FILE, MAX_LENGTH, MAX_PARAMETERS, read_source


@pytest.fixture(scope="module")
def functions():
    code = [path for path in files_below(ROOT) if group_of(path) is not None]
    found = [(f"{path}:{f.line} {f.name}", f) for path in code for f in read_source(ROOT, path).functions]
    assert len(found) > 3000  # or the tree was not found
    return found


def test_no_function_is_too_long(functions):
    assert [(name, f.n_lines) for name, f in functions if f.n_lines > MAX_LENGTH] == []


def test_no_function_has_too_many_parameters(functions):
    assert [(name, f.n_parameters) for name, f in functions if f.n_parameters > MAX_PARAMETERS] == []


def test_no_file_is_too_long():
    code = [path for path in files_below(ROOT) if path.suffix in LANGUAGES and path.parts[0] != "docs"]
    lines = {str(path): len((ROOT / path).read_text(errors="replace").splitlines()) for path in code}
    assert {path: n for path, n in lines.items() if n > MAX_FILE} == {}
