"""Runs tests on a sanitized build of the core, whatever else is installed: `make check`.

    LD_PRELOAD=libasan.so:... python tests/sanitized.py PACKAGE_DIR TESTS...

PACKAGE_DIR holds the package with the sanitized `_core`. An editable installation redirects imports to
its own build; its finder is taken out.
"""

import sys

import pytest


def main() -> int:
    """Exit code of pytest."""
    folder, *tests = sys.argv[1:]
    sys.meta_path[:] = [finder for finder in sys.meta_path if "ScikitBuild" not in type(finder).__name__]
    sys.path.insert(0, folder)
    import fiberloom._core as core

    if not str(core.__file__).startswith(folder):
        print(f"tests/sanitized.py: imports {core.__file__} instead of what is in {folder}")
        return 2
    # a sanitizer writes to the terminal itself, and ends the process
    return pytest.main(["-p", "no:cacheprovider", "-p", "no:xdist", "--capture=sys", *tests])


if __name__ == "__main__":
    sys.exit(main())
