"""Builds the rig and the images of the targets, or says which package is missing."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BOARD = ROOT / "firmware" / "boards" / "stm32f405"
MACHINE = "mps2-an386"
PACKAGES = {
    "arm-none-eabi-gcc": "gcc-arm-none-eabi",
    "arm-none-eabi-g++": "gcc-arm-none-eabi",
    "qemu-system-arm": "qemu-system-arm",
}
"""Program to Debian package; beside them the libraries of `LIBRARIES`."""
LIBRARIES = {"newlib.h": "libnewlib-arm-none-eabi", "vector": "libstdc++-arm-none-eabi-newlib"}
"""Header that the cross-compiler must find, to Debian package."""


class Missing(Exception):
    """What a target needs and this machine has not; the text names the packages."""


def _finds(header: str) -> bool:
    """Whether the cross-compiler finds a header of its libraries."""
    done = subprocess.run(
        ["arm-none-eabi-g++", "-x", "c++", "-fsyntax-only", "-"],
        input=f"#include <{header}>\n",
        text=True,
        capture_output=True,
        check=False,
    )
    return done.returncode == 0


def missing_packages() -> list[str]:
    """Debian packages without which cortex-m4f is neither built nor run; in the order of their names."""
    missing = {package for program, package in PACKAGES.items() if shutil.which(program) is None}
    if PACKAGES["arm-none-eabi-g++"] in missing:
        missing |= set(LIBRARIES.values())
    else:
        missing |= {package for header, package in LIBRARIES.items() if not _finds(header)}
    return sorted(missing)


def _tool(name: str) -> str:
    """A program of this Python's environment, or of the path."""
    beside = Path(sysconfig.get_path("scripts")) / name
    return str(beside) if beside.exists() else name


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """One builder at a time: tests run in several processes."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _configure(target: str, folder: Path) -> None:
    options = [f"-DCMAKE_TOOLCHAIN_FILE={BOARD / 'toolchain.cmake'}"] if target == "cortex-m4f" else []
    options += [f"-DCMAKE_MAKE_PROGRAM={_tool('ninja')}"] if Path(_tool("ninja")).is_absolute() else []
    options += ["-G", "Ninja", "-DFIBERLOOM_PYTHON=OFF", "-DFIBERLOOM_RIG=ON"]
    _run([_tool("cmake"), "-S", str(ROOT), "-B", str(folder), *options])


def _run(command: list[str]) -> None:
    done = subprocess.run(command, text=True, capture_output=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}\n{done.stdout}{done.stderr}")


@cache
def build(target: str) -> Path:
    """Builds everything of a target, once; the folder with its programs. Raises Missing."""
    if target == "cortex-m4f" and (missing := missing_packages()):
        raise Missing(f"cortex-m4f needs the Debian packages {' '.join(missing)}")
    folder = ROOT / "build" / "rig" / target
    with _alone(folder):
        _configure(target, folder)
        _run([_tool("cmake"), "--build", str(folder)])
    return folder / "programs"


def rig_command(target: str) -> list[str]:
    """What runs the rig of a target, built if need be. Raises Missing."""
    programs = build(target)
    if target == "host":
        return [str(programs / "rig")]
    options = ["-M", MACHINE, "-icount", "shift=0", "-display", "none", "-monitor", "none", "-serial", "null"]
    semihosting = ["-semihosting-config", "enable=on,target=native"]
    return ["qemu-system-arm", *options, *semihosting, "-kernel", str(programs / "rig.elf")]


INSTALL_LIMIT_S = 900.0


def _apt(*arguments: str) -> bool:
    environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    try:
        done = subprocess.run(
            ["apt-get", *arguments],
            env=environment,
            capture_output=True,
            timeout=INSTALL_LIMIT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def install() -> bool:
    """Tries to install what is missing, as root, quietly; whether nothing is missing now."""
    missing = missing_packages()
    if missing and os.geteuid() == 0 and shutil.which("apt-get"):
        command = ("install", "--yes", "--quiet", "--no-install-recommends", *missing)
        if not _apt(*command) and _apt("update", "--quiet"):
            _apt(*command)
    return not missing_packages()
