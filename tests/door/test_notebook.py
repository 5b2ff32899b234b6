"""The notebook as a user would type it: a script, a loop that runs, Jupyter, a doctest."""

import ast
import asyncio
import doctest
import inspect
import re
from pathlib import Path

import matplotlib as mpl
import pytest
from door_snippet import as_script, judge, printed, small

mpl.use("Agg")
ROOT = Path(__file__).resolve().parents[2]


def test_it_is_the_block_that_was_agreed():
    for line in (
        'plane = fl.FocalPlane.of("sdssv", seed=0, n=50)',
        "field = fl.Field.twin(plane, seed=0)",
        "await field.calibrate()",
        'seen = await field.observe(fl.read_targets("targets.csv"), corrections=2)',
        "seen.table()",
        "seen.plot()",
    ):
        assert line in printed()
    assert small(printed()).count("n=7") == small(printed()).count('camera="noise"') == 1


def test_as_a_script(desk):
    names = {}
    exec(compile(as_script(small(printed())), "script", "exec"), names)
    judge(names)


def test_as_printed_with_await_at_the_top(desk):
    code = compile(small(printed()), "cell", "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
    assert code.co_flags & inspect.CO_COROUTINE
    names = {}
    asyncio.run(eval(code, names))  # as `python -m asyncio` does
    judge(names)


def test_as_a_doctest(desk):
    lines = as_script(small(printed())).splitlines()
    # values are not compared: a name takes them
    text = "\n".join(f">>> {line}" if "=" in line or "import" in line else f">>> _ = {line}"
                     for line in lines if line.strip())  # fmt: skip
    test = doctest.DocTestParser().get_doctest(text, {}, "README", None, None)
    done = doctest.DocTestRunner().run(test, out=(said := []).append, clear_globs=False)
    assert done.attempted == 7
    assert done.failed == 0, "".join(said)
    judge(test.globs)


def run_notebook(path, folder, replace=()):
    """Executes a notebook in a kernel of its own; returns it."""
    reason = "pip install nbformat nbclient: notebooks, as in constraints.txt"
    nbformat = pytest.importorskip("nbformat", reason=reason)
    nbclient = pytest.importorskip("nbclient", reason=reason)
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        for old, new in replace:
            cell.source = cell.source.replace(old, new)
    resources = {"metadata": {"path": str(folder)}}
    return nbclient.NotebookClient(notebook, timeout=300, resources=resources).execute()


def outputs(notebook):
    return [out for cell in notebook.cells if cell.cell_type == "code" for out in cell.outputs]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_the_tutorial_runs_in_jupyter(desk):
    (desk / "targets_sdssv.csv").symlink_to(ROOT / "examples" / "targets_sdssv.csv")
    few = (("n=50", "n=7"), ("seed=0)\nfield", 'seed=0, camera="noise")\nfield'))
    done = run_notebook(ROOT / "examples" / "first_field.ipynb", desk, few)
    found = outputs(done)
    assert sum("image/png" in out.get("data", {}) for out in found) == 2  # both figures are shown
    said = "".join(str(out.get("text", "")) for out in found)
    assert re.search(r"blind +\d+\.\d\d um rms\ncorrection 1 +\d+\.\d\d um rms", said)
    html = [out["data"]["text/html"] for out in found if "text/html" in out.get("data", {})]
    assert len(html) == 3  # plane, observation, table
    assert not any(out.output_type == "error" for out in found)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_cell_without_await_says_what_to_write(desk):
    import nbformat

    field = 'import fiberloom as fl\nfield = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7))'
    cells = [nbformat.v4.new_code_cell(field), nbformat.v4.new_code_cell("field.run.calibrate()")]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), desk / "wrong.ipynb")
    with pytest.raises(Exception, match=r"await field\.calibrate"):
        run_notebook(desk / "wrong.ipynb", desk)
