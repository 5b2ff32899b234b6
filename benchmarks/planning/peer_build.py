"""Builds the peer, kaiju, in the environment that runs this: `make kaiju`.

Its build fetches two files of coordio from the web. The source archive has the same two files, and they are
taken from there: that needs no network beyond the package index, and each build is of the same sources.
Where the build fails, the reason is left in a file for the benchmark to tell.
"""

import hashlib
import io
import runpy
import subprocess
import sys
import tarfile
import tempfile
import urllib.request
from pathlib import Path

VERSION = "1.4.1"
SHA256 = "f967d4bec656472148f6bd8cf05266c6fa8b907f0dda950db7632c01fd18aa15"
WHY_NOT = Path(sys.prefix) / "why-not.txt"
FETCHED = {
    "src/coordio/include/coordio.h": "python/kaiju/include/coordio.h",
    "cextern/conv.cpp": "src/conv.cpp",
}
"""What the build asks for, and where the archive has it."""


def main() -> int:
    """Fetches, builds, installs; 1 and a file with the reason where one of them fails."""
    WHY_NOT.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        try:
            source = unpacked(Path(folder))
            run(sys.executable, __file__, "--wheel", str(source))
            (wheel,) = (source / "dist").glob("*.whl")
            pip("install", "--no-deps", "--no-index", "--force-reinstall", str(wheel))
        except (RuntimeError, ValueError, OSError) as error:
            WHY_NOT.write_text(f"{error}\n")
            print(error, file=sys.stderr)
            return 1
    return 0


def unpacked(folder: Path) -> Path:
    """The folder of the sources."""
    pip("download", "--no-deps", "--no-build-isolation", "--use-pep517", "--no-binary", ":all:",
        "--dest", str(folder), f"sdss-kaiju=={VERSION}")  # fmt: skip
    (archive,) = folder.glob("*.tar.gz")
    found = hashlib.sha256(archive.read_bytes()).hexdigest()
    if found != SHA256:
        raise ValueError(f"{archive.name}: sha256 {found}, not {SHA256}")
    with tarfile.open(archive) as tar:
        tar.extractall(folder, filter="data")
    return next(path.parent for path in folder.glob("*/setup.py"))


def pip(*words: str) -> None:
    run(sys.executable, "-m", "pip", "--quiet", *words)


def run(*words: str) -> None:
    """Raises RuntimeError with the last lines of what it said."""
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        said = (done.stdout + done.stderr).strip().splitlines()
        wrong = [line.strip() for line in said if "rror" in line] or said
        raise RuntimeError(f"kaiju {VERSION} cannot be built: {' / '.join(wrong[-3:])}")


def wheel(source: Path) -> None:
    """setup.py as it is, with files of the archive in place of those of the web."""
    import os

    import setuptools

    os.chdir(source)
    urllib.request.urlopen = lambda url, *_: io.BytesIO(
        Path(next(here for end, here in FETCHED.items() if url.endswith(end))).read_bytes()
    )
    setup = setuptools.setup
    setuptools.setup = lambda **words: setup(**{k: v for k, v in words.items() if k != "setup_requires"})
    sys.argv = ["setup.py", "bdist_wheel"]
    runpy.run_path("setup.py", run_name="__main__")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--wheel"]:
        wheel(Path(sys.argv[2]).resolve())
    else:
        sys.exit(main())
