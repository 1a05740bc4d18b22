# SPDX-License-Identifier: GPL-3.0-or-later
"""Resources of every kernel on graphics cards, from offline compilers.

    python -m tests.benchmarks.offline

Compiles every program, with the options and in the variants that the extension builds, with clang
for AMD's gfx1030 (Radeon RX 6000) and NVIDIA's sm_86 (GeForce RTX 30), the latter through ptxas.
Prints the registers, spills, and scratch or stack of the largest variant of each kernel; writes
build/bench/offline.json. The compilers of the drivers differ, but are similar. Fails if a program
does not compile, and reports it if the compilers are not available.
"""

import re
import sys
from itertools import chain, combinations, product
from multiprocessing.pool import ThreadPool

from lb_lighting.transport.device import _BUILD_OPTIONS, _SOURCES
from lb_lighting.transport.lattice import lattice_opencl
from lb_lighting.transport.photons import majorants_opencl
from lb_lighting.transport.solver import KERNELS
from tests.benchmarks.table import publish
from tests.setup import compilers

PHYSICAL = (lattice_opencl._SOURCES, lattice_opencl._CONSTANTS)
MAJORANTS_OF_PATHS = ((), ("RAY_MARCH",), ("WOODCOCK",), ("POLYNOMIAL",))
FLOPS = {"add": 1, "sub": 1, "mul": 1, "fma": 2, "mad": 2, "div": 1, "rcp": 1, "neg": 0}


def subsets(*names):
    """All subsets of the names."""
    return chain.from_iterable(combinations(names, n) for n in range(len(names) + 1))


def programs():
    """(files, defines) of the extension's programs; photons with the fewest and most tallies."""
    yield PHYSICAL
    for some in subsets("DIRECTED", "OCCLUDED", "EMITTING"):
        yield ("uncollided/attenuation.cl", "uncollided/sweep.cl"), some
    yield ("uncollided/attenuation.cl", "uncollided/sweep.cl"), ("EMITTING", "APART")
    for some in subsets("OCCLUDED"):
        yield ("uncollided/attenuation.cl", "uncollided/march.cl"), some
    shape = ("WIDTH=128", "HEIGHT=128", "DEPTH=128")
    for kernel, first, some in product(KERNELS, (0, 1), subsets("OCCLUSION")):
        yield (f"paper/{kernel}.cl",), (*shape, f"FIRST={first}", *some)
    yield ("photons/majorants.cl",), majorants_opencl.defines()
    for sampler, linear, noise in product(MAJORANTS_OF_PATHS, subsets("LINEAR"), (False, True)):
        files = ("photons/random.cl", *(["photons/perlin.cl"] if noise else []), "photons/paths.cl")
        defines = (*sampler, *linear, *(["PERLIN_MEDIUM"] if noise else []))
        yield (*files, "photons/free_path.cl"), defines
        for kept in ((), ("KEEP_DIRECT", "KEEP_FLUX", "OCCLUSION")):
            yield (*files, "photons/scatter.cl", "photons/photons.cl"), (*defines, *kept)
        if not linear:
            for kept in ((), ("OCCLUSION", "EMISSION")):
                yield (*files, "photons/scatter.cl", "preview/preview.cl"), (*defines, *kept)


def assembly(program, target):
    """The assembly of one of `programs()`."""
    files, defines = program
    text = "\n".join((_SOURCES / name).read_text() for name in files)
    options = [*_BUILD_OPTIONS.split(), *(f"-D{define}" for define in defines)]
    return compilers.assembly(text, options, target)


def needs(program):
    """{kernel: {column: number}} for both cards."""
    amd = compilers.amd_needs(assembly(program, compilers.AMD))
    nvidia = compilers.nvidia_needs(assembly(program, compilers.NVIDIA))
    return {
        kernel: {f"AMD: {what}": n for what, n in amd[kernel].items()}
        | {f"NVIDIA: {what}": n for what, n in nvidia[kernel].items()}
        for kernel in amd
    }


def tried(program):
    """The needs of a program, or the message of a compiler."""
    try:
        return needs(program)
    except compilers.CompileError as error:
        return str(error)


def of_a_cell(kernel):
    """{"read", "written": bytes, "flops"} of a work-item of a step, from its branchless PTX."""
    text = assembly(PHYSICAL, compilers.NVIDIA)
    body = re.search(rf"\.entry {kernel}\(.*?\n}}", text, re.S)[0]
    operations = re.findall(r"^\s+(\w+)(?:\.\w+)*\.f32\s", body, re.M)
    return {
        "read": 4 * len(re.findall(r"\sld\.global\S*\.f32\s", body)),
        "written": 4 * len(re.findall(r"\sst\.global\S*\.f32\s", body)),
        "flops": sum(FLOPS.get(operation, 0) for operation in operations),
        "divisions": sum(operation in ("div", "rcp") for operation in operations),
    }


def rows():
    compilers.fetch()
    with ThreadPool() as pool:
        results = list(zip(programs(), pool.imap(tried, programs()), strict=True))
    failed = [" ".join(sum(p, ())) + f"\n{error}" for p, error in results if isinstance(error, str)]
    if failed:
        sys.exit("\n".join(failed))
    found = {}
    for (files, _), kernels in results:
        for kernel, numbers in kernels.items():
            found.setdefault((files[-1], kernel), []).append(numbers)
    for (file, kernel), variants in found.items():
        worst = {column: max(v[column] for v in variants) for column in variants[0]}
        yield {"file": file, "kernel": kernel, "variants": len(variants), **worst}


def main():
    print("A step of the lattice for one cell:", of_a_cell("step_here"), of_a_cell("step_there"))
    publish("offline", f"{compilers.AMD[1]} and {compilers.NVIDIA[1]}", list(rows()))


if __name__ == "__main__":
    main()
