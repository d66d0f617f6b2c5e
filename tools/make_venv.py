"""Make the virtual environment that `make setup` fills: `python3 tools/make_venv.py .venv`.

Checks the Python version first, and copes with a Python whose `ensurepip` was split off into another
package (as Debian does) by borrowing that Python's own pip. Runs on Python 3.6 and later, so that an old one
ends in a sentence instead of a syntax error.
"""

import os
import shutil
import subprocess
import sys

NEEDED = (3, 10)
TOO_OLD = "Urushi needs Python {}.{} or newer; name one: make setup PYTHON=/path/to/python3"
NO_PIP = """This Python has neither 'ensurepip' nor 'pip', so a virtual environment cannot be filled.
  Debian, Ubuntu: install the package python3-venv
  elsewhere:      install pip for {python}, or name another Python: make setup PYTHON=python3.12"""


def newest_python():
    """The path of this Python, or of a newer one on PATH when this one is too old; None without one."""
    if sys.version_info[:2] >= NEEDED:
        return sys.executable
    for minor in range(20, NEEDED[1] - 1, -1):
        found = shutil.which(f"python3.{minor}")
        if found:
            return found
    return None


def has(python, module):
    """Whether `python` can import `module`."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.call([python, "-c", "import " + module], **quiet) == 0


def main(folder):
    """Make `folder`; returns the exit status."""
    python = newest_python()
    if python is None:
        print(TOO_OLD.format(*NEEDED))
        return 1
    if has(python, "ensurepip"):
        return subprocess.call([python, "-m", "venv", folder])
    if not has(python, "pip"):
        print(NO_PIP.format(python=python))
        return 1
    status = subprocess.call([python, "-m", "venv", "--without-pip", folder])
    if status:
        return status
    inside = os.path.join(folder, "Scripts" if os.name == "nt" else "bin", "python")
    return subprocess.call([python, "-m", "pip", "--python", inside, "install", "--quiet", "pip"])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
