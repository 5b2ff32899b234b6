"""Every public name has numpydoc sections and an example that runs."""

import doctest
import inspect

import matplotlib as mpl
import pytest

import fiberloom as fl

mpl.use("Agg")
NAMES = [name for name in fl.__all__ if name != "__version__"]


def members(name):
    """The public object, and the public methods that it defines itself."""
    thing = getattr(fl, name)
    yield name, thing
    if not inspect.isclass(thing):
        return
    for key, value in vars(thing).items():
        function = inspect.unwrap(getattr(value, "__func__", value))
        if not key.startswith("_") and inspect.isfunction(function):
            yield f"{name}.{key}", function


ALL = dict(pair for name in NAMES for pair in members(name))
# pydantic's hooks, and handing on
BESIDE = {"Instrument.model_post_init"}


@pytest.mark.parametrize("name", [n for n in ALL if n not in BESIDE])
def test_examples_run(name, desk, capsys):
    parser = doctest.DocTestParser()
    test = parser.get_doctest(inspect.getdoc(ALL[name]), {}, name, None, None)
    assert test.examples, f"{name}: no example"
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    runner.run(test, out=(said := []).append)
    assert runner.failures == 0, "".join(said)


def test_the_example_of_the_package_runs(desk):
    test = doctest.DocTestParser().get_doctest(fl.__doc__, {}, "fiberloom", None, None)
    runner = doctest.DocTestRunner()
    done = runner.run(test, out=(said := []).append)
    assert done.attempted >= 6
    assert done.failed == 0, "".join(said)


@pytest.mark.parametrize("name", [n for n in ALL if inspect.isfunction(ALL[n]) and n not in BESIDE])
def test_parameters_and_results_are_documented(name):
    function, text = ALL[name], inspect.getdoc(ALL[name])
    signature = inspect.signature(function)
    asked = [p for p in signature.parameters if p not in ("self", "cls")]
    if asked:
        section = text.split("Parameters\n----------\n", 1)[1].split("\n\n", 1)[0]
        named = {w.strip(" *") for line in section.splitlines() if line[:1].strip()
                 for w in line.split(" : ")[0].split(",")}  # fmt: skip
        wanted = {p for p in asked if p != "options"}
        assert wanted <= named, f"{name} does not document {sorted(wanted - named)}"
    if signature.return_annotation not in (None, "None", inspect.Signature.empty):
        assert "Returns\n-------\n" in text or name.split(".")[-1] == "last"
