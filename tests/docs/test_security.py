"""What SECURITY.md says of dependencies is so."""

import importlib.metadata
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
NEEDED = [
    re.match(r"[\w-]+", line)[0]
    for line in sum(
        (EXTRAS[e] for e in ("cameras", "serve", "opcua", "epics", "postgres")), PROJECT["dependencies"]
    )
]
ROWS = re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", (ROOT / "SECURITY.md").read_text(), flags=re.M)
LICENCE = {name: licence for names, licence in ROWS for name in re.sub(r" \(.*\)", "", names).split(", ")}
FAMILIES = {"BSD": "BSD", "MIT": "MIT", "LGPL": "LGPL", "Apache": "Apache", "PSF": "Python Software"}


def said_by(package):
    """What the package says of its own licence."""
    about = importlib.metadata.metadata(package)
    classifiers = [c for c in about.get_all("Classifier", []) if c.startswith("License")]
    return " ".join([about.get("License-Expression") or about.get("License") or "", *classifiers])


@pytest.mark.parametrize("package", NEEDED)
def test_each_dependency_is_named_with_its_licence(package):
    family = next(word for word in FAMILIES if word in LICENCE[package])
    assert FAMILIES[family] in said_by(package)


def test_the_environment_is_pinned_by_hashes():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    packages = [i for i, line in enumerate(lines) if re.match(r"[a-z]", line)]
    assert len(packages) > 100
    for i in packages:
        assert re.fullmatch(r"[a-z0-9.-]+==\S+ \\", lines[i]), lines[i]
        assert "--hash=sha256:" in lines[i + 1]


def test_a_newer_release_of_a_package_does_not_stop_the_setup():
    """pip 23 takes the newest `coverage[toml]` for pytest-cov, not the lock's, and then misses its hash."""
    (line,) = [
        line
        for line in (ROOT / "Makefile").read_text().splitlines()
        if "pip install" in line and "-r constraints.txt" in line
    ]
    assert "--no-deps" in line
