"""Makes the peers' environments: one for each requirements file in this folder, as pins of some exclude others.

    python benchmarks/peers/install.py [NAME ...]

``requirements.txt`` goes into ``.venv-peers`` and ``requirements-NAME.txt`` into ``.venv-peers-NAME``, made with the
Python that runs this file, of built packages only. NAME is the folder of an environment; without any, all are made.
Every requirement gets a line that says whether it is there and can be imported, or why not; an environment that is
whole already is left as it is. The exit status is 1 when nothing can be used.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import venv
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]

#: Run by an environment's Python: imports what the distribution in argv brings.
PROBE = """
import importlib, sys
from importlib import metadata
name = sys.argv[1]
ours = [top for top, owners in metadata.packages_distributions().items()
        if name.replace("_", "-").lower() in {owner.replace("_", "-").lower() for owner in owners}]
for top in ours:
    if not top.startswith("_") and top not in ("tests", "bin", "share"):
        importlib.import_module(top)
"""


def environments() -> dict[str, Path]:
    """Each environment's folder and the file of what stands in it."""
    files = sorted(HERE.glob("requirements*.txt"))
    return {f".venv-peers{file.stem.removeprefix('requirements')}": file for file in files}


def requirements(file: Path) -> list[str]:
    """The requirements of a file, a line each, without comments."""
    lines = (line.split("#")[0].strip() for line in file.read_text().splitlines())
    return [line for line in lines if line]


def install(folder: str, file: Path) -> bool:
    """Makes an environment, unless it is there as wanted; returns whether anything in it can be used.

    One that was there before comes back where nothing of the new one can be used, as without a network.
    """
    path = ROOT / folder
    before, stamp = path.with_name(f"{folder}.before"), path / "made-of.txt"
    wanted = f"python {sys.version}\n{file.read_text()}"
    if before.exists():  # the last run was interrupted: what it was making is not whole
        shutil.rmtree(path, ignore_errors=True)
        before.rename(path)
    if stamp.is_file() and stamp.read_text() == wanted:
        print(f"{folder}: is there", flush=True)
        return True
    if path.exists():
        path.rename(before)
    usable, complete = fill(path, requirements(file))
    if complete:
        stamp.write_text(wanted)
    if not usable and before.exists():
        shutil.rmtree(path, ignore_errors=True)
        before.rename(path)
        print(f"{folder}: what was there before is kept", flush=True)
        return True
    shutil.rmtree(before, ignore_errors=True)
    return usable


def fill(path: Path, wanted: list[str]) -> tuple[bool, bool]:
    """A new environment; says of each requirement what came of it, and returns whether any can be used, and all."""
    folder = path.name
    venv.create(path, with_pip=True)
    python = path / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary=:all:"]
    reasons = {}
    if run(pip + wanted):
        for one in wanted:  # what cannot be had must not keep the others away
            others = path / "others.txt"
            others.write_text("\n".join(set(wanted) - {one}))
            reasons[one] = run(pip + ["-c", str(others), one])
    usable, complete = False, True
    for one in wanted:
        said = "installed"
        if reasons.get(one):
            said = f"NOT INSTALLED: {reasons[one]}"
        elif broken := run([str(python), "-c", PROBE, one.split("==")[0]]):
            said = f"NOT USABLE: {broken}"
        usable |= said == "installed"
        complete &= said == "installed"
        print(f"{folder}: {one}: {said}", flush=True)
    return usable, complete


def run(words: list[str]) -> str:
    """Runs a command; empty, or a line that tells why it failed."""
    done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if not done.returncode:
        return ""
    lines = [line.strip() for line in done.stdout.splitlines() if line.strip()]
    telling = [line for line in lines if line.startswith("ERROR:")] or lines[-1:] or [f"status {done.returncode}"]
    return telling[0].removeprefix("ERROR: ")[:300]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = environments()
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(known))
    args = parser.parse_args()
    for name in args.names:
        if name not in known:
            parser.error(f"{name!r} is none of {', '.join(known)}")
    usable = [install(name, known[name]) for name in args.names or known]
    sys.exit(not any(usable))


if __name__ == "__main__":
    main()
