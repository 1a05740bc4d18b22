# SPDX-License-Identifier: GPL-3.0-or-later
"""Offline compilers for graphics cards: Debian's clang, and ptxas from PyPI; no root needed.

They are downloaded on the first call (200 MB) and cached in `build/assets`.
"""

import os
import re
import subprocess
import sys

from tests.setup.debian import ASSETS, package

PTXAS = "nvidia-cuda-nvcc-cu12==12.9.86"
PACKAGES = ("clang-19", "libclang-cpp19", "libllvm19", "libclang-common-19-dev")
AMD, NVIDIA = ("amdgcn-amd-amdhsa", "gfx1030"), ("nvptx64-nvidia-nvcl", "sm_86")
"""(target of clang's, processor): Radeon RX 6000, GeForce RTX 30."""


class CompileError(Exception):
    """A compilation failed; the message is the compiler's."""


def fetch():
    """Download everything that is missing."""
    _clang()
    _amd("")
    _nvidia("")
    ptxas()


def assembly(source, options, target):
    """The assembly of a kernel's text, as a driver would compile it with these options."""
    clang, libraries, common = _clang()
    triple, processor = target
    command = [clang, "-x", "cl", "-", "-o", "-", "-S", "-O3", "-target", triple]
    command += [f"-resource-dir={common}", "-Xclang", "-finclude-default-header"]
    command += [*options, "-Wno-linker-warnings", "-Wno-unused-command-line-argument"]
    command += _amd(processor) if target == AMD else _nvidia(processor)
    environment = os.environ | {"LD_LIBRARY_PATH": libraries}
    return _run(command, source, env=environment)


def _run(command, text, **options):
    done = subprocess.run(command, input=text, capture_output=True, text=True, **options)
    if done.returncode != 0:
        raise CompileError(done.stderr)
    return done.stdout + done.stderr


def _clang():
    """(program, folders of its libraries, folder of its headers)."""
    clang, cpp, llvm, common = (package(name) for name in PACKAGES)
    libraries = [cpp / "usr/lib/x86_64-linux-gnu", llvm / "usr/lib/x86_64-linux-gnu"]
    libraries += [cpp / "usr/lib/llvm-19/lib", llvm / "usr/lib/llvm-19/lib"]
    headers = common / "usr/lib/llvm-19/lib/clang/19"
    return clang / "usr/lib/llvm-19/bin/clang", ":".join(map(str, libraries)), headers


def _amd(processor):
    """AMD's device library."""
    bitcode = package("rocm-device-libs") / "usr/lib/x86_64-linux-gnu/amdgcn/bitcode"
    return [f"-mcpu={processor}", f"--rocm-device-lib-path={bitcode}"]


def _nvidia(processor):
    """The open library, as NVIDIA's is part of its driver; with -cl-denorms-are-zero."""
    library = package("libclc-19") / "usr/lib/clc/nvptx64--nvidiacl.bc"
    flags = ["-mlink-builtin-bitcode", str(library), "-fdenormal-fp-math-f32=preserve-sign"]
    given = [word for flag in flags for word in ("-Xclang", flag)]
    return [f"-march={processor}", "-nogpulib", *given]


def ptxas():
    """NVIDIA's assembler."""
    folder = ASSETS / "ptxas"
    path = folder / "nvidia/cuda_nvcc/bin/ptxas"
    if not path.exists():
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, "--no-deps", "--target", folder, PTXAS], check=True)
        path.chmod(0o755)
    return path


# --- What kernels need ---------------------------------------------------------------------------


def amd_needs(text):
    """{kernel: {resource: number}} from the assembly for AMD."""
    listed = text[text.index("amdhsa.kernels:") : text.index("amdhsa.target:")]
    found = {}
    for kernel in listed.split("\n  - ")[1:]:
        fields = dict(re.findall(r"^\s*\.(\w+): +(\S+)$", kernel, re.M))
        found[re.search(r"^    \.name: +(\w+)$", kernel, re.M)[1]] = {
            "VGPRs": int(fields["vgpr_count"]),
            "SGPRs": int(fields["sgpr_count"]),
            "VGPRs spilled": int(fields["vgpr_spill_count"]),
            "SGPRs spilled": int(fields["sgpr_spill_count"]),
            "scratch, B": int(fields["private_segment_fixed_size"]),
        }
    return found


def nvidia_needs(text):
    """{kernel: {resource: number}} from the assembly for NVIDIA, by its assembler."""
    command = [ptxas(), f"-arch={NVIDIA[1]}", "-v", "/dev/stdin", "-o", "/dev/null"]
    found = {}
    for kernel in _run(command, text).split("Compiling entry function '")[1:]:
        found[kernel.split("'")[0]] = {
            "registers": int(re.search(r"Used (\d+) registers", kernel)[1]),
            "spilled, B": int(re.search(r"(\d+) bytes spill stores", kernel)[1]),
            "stack, B": int(re.search(r"(\d+) bytes stack frame", kernel)[1]),
        }
    return found
