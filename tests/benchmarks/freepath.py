# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of "Free Path Sampling in High Resolution Inhomogeneous Participating Media".

A head of 512^3 voxels at different resolutions of the super-voxels, then fractal noise at different
effective resolutions and contrasts. Only free-path sampling is timed, without preparation: rays per
second of the device's kernel, the median of several batches. Rays enter uniformly over the faces
from all directions, like the photons of a sky. A slow sampler gets fewer rays.

The talk does not state how dense its media are, and all ratios depend on it. The head is therefore
measured at three densities: thin, dense, and the density at which the times of ray marching and
Woodcock tracking have the talk's ratio, 9 : 7. The noise is so dense that half of the rays collide.
"""

import sys

from lb_lighting.transport import device
from tests.benchmarks.freepath_head import EDGE, TALK, head_rows, head_summary, step_costs
from tests.benchmarks.freepath_noise import noise_rows, noise_summary
from tests.benchmarks.freepath_timing import SUPERVOXELS
from tests.benchmarks.table import publish


def markdown(rows):
    """Rows as a Markdown table for docs/."""
    columns = list(dict.fromkeys(column for row in rows for column in row))
    lines = [columns, ["---"] * len(columns)]
    lines += [[rounded(row.get(column, "")) for column in columns] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def rounded(value):
    """A number with about three digits, without an exponent."""
    if not isinstance(value, float):
        return str(value)
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}" if value >= 0.001 else f"{value:.5f}"


def by_resolution(rows, setting):
    """The head's speeds, million rays/s, and majorants at one density: a row per resolution."""
    speeds = {
        (row["sampler"], row["super-voxels"]): row for row in rows if row["setting"] == setting
    }
    for cells in sorted({cells for _, cells in speeds}):
        line = {"super-voxels": f"{cells}³"}
        for sampler in SUPERVOXELS:
            row = speeds.get((sampler, cells))
            kind = sampler.removeprefix("supervoxel_")
            mark = " (automatic)" if row and row["automatic"] else ""
            line[f"{kind}, majorant / density"] = rounded(row["majorant / density"]) if row else ""
            line[f"{kind}, million rays/s"] = rounded(row["million rays/s"]) + mark if row else ""
        yield line
    for sampler, cells in (("ray_march", EDGE), ("woodcock", 1)):
        row = speeds[sampler, cells]
        yield {
            "super-voxels": f"`{sampler}`",
            "constant, majorant / density": row["majorant / density"],
            "constant, million rays/s": row["million rays/s"],
        }


def by_noise(rows):
    """The speeds in noise, million rays/s: a row per noise."""
    lines = {}
    for row in rows:
        line = lines.setdefault(
            (row["resolution"], row["contrast"]),
            {
                "resolution": f"{row['resolution']}³",
                "contrast": row["contrast"],
                "largest / mean": row["largest / mean"],
                "optical depth": row["depth"],
            },
        )
        name = row["sampler"].replace("supervoxel_", "")
        chosen = f" ({row['super-voxels']}³)" if row["automatic"] else ""
        if row["sampler"] in SUPERVOXELS and not chosen:
            name += f", {row['super-voxels']}³"
        line[name] = rounded(row["million rays/s"]) + chosen
    return list(lines.values())


def main():
    found = device.choose()
    if found.kind == "NumPy":
        sys.exit("There is no OpenCL device to measure.")
    head = head_rows(found)
    tables = {"head": head, "head-best": list(head_summary(head))}
    tables |= {"head-steps": list(step_costs(head))}
    publish_all(tables, found)
    noise = list(noise_rows(found))
    of_noise = {"noise": noise, "noise-best": list(noise_summary(noise))}
    publish_all(of_noise, found)
    tables |= of_noise | {"head": list(by_resolution(head, TALK)), "noise": by_noise(noise)}
    print("\nFor docs/measurements/free-paths.md:\n")
    print("\n".join(markdown(rows) for rows in tables.values()))


def publish_all(tables, found):
    for name, rows in tables.items():
        publish(f"freepath-{name}", found.label, rows)


if __name__ == "__main__":
    main()
