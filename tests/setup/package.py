# SPDX-License-Identifier: GPL-3.0-or-later
"""Download the wheels in the manifest, build the extension's zip in `build/`, and validate it."""

import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build"
BUILDER = "5.2/scripts/addons_core/bl_pkg/cli/blender_ext.py"


def manifest():
    """The extension's manifest as a dict."""
    return tomllib.loads((ROOT / "blender_manifest.toml").read_text())


def archive():
    """The path of the zip of this version."""
    return BUILD / f"{manifest()['id']}-{manifest()['version']}.zip"


def fetch(wheel):
    """Download the wheel with exactly this file name, unless it exists."""
    if wheel.exists():
        return
    name, version, python, abi, platforms = wheel.stem.split("-")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
    command += ["--only-binary=:all:", "--dest", wheel.parent, f"{name}=={version}"]
    command += [f"--platform={platform}" for platform in platforms.split(".")]
    if abi != "none":
        command += ["--implementation=cp", f"--python-version={python[2:]}", f"--abi={abi}"]
    subprocess.run(command, check=True)
    if not wheel.exists():
        sys.exit(
            f"There is no {wheel.name} to download; correct the name in blender_manifest.toml."
        )


def extension_tool(*arguments):
    """Run the builder of Blender's extension system, which the `bpy` wheel contains."""
    tool = Path(find_spec("bpy").origin).parent / BUILDER
    subprocess.run([sys.executable, tool, *arguments], check=True)


def main():
    for wheel in manifest()["wheels"]:
        fetch(ROOT / wheel)
    BUILD.mkdir(exist_ok=True)
    extension_tool("build", f"--source-dir={ROOT}", f"--output-dir={BUILD}")
    extension_tool("validate", archive())


if __name__ == "__main__":
    try:
        main()
    except subprocess.CalledProcessError as error:
        sys.exit(f"Packaging failed: `{' '.join(map(str, error.cmd))}`; see above.")
