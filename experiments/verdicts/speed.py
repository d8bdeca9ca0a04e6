"""Time of 50 verdicts on a survey of 10 million points in 16 files, beside that of finding its ground.

python experiments/verdicts/speed.py
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import sys
from pathlib import Path

import geopandas
import laspy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.report import write_page
from experiments.tiling.scale import COMMAND, watched
from jaxfilter.reports.verdicts import RIM

HERE = Path(__file__).parent
SIDE, VERDICTS, MOST, TURNS = 500.0, 50, 2500.0, 3
"""Metres of a file; verdicts; square metres of a place with one, at most; runs of both commands."""


def survey(folder: Path, files: int, density: float) -> None:
    """Files side by side: one simulated scene, moved. Its places are those of every file."""
    folder.mkdir(parents=True)
    scene = jf.scenes.make("mixed", seed=3, size=SIDE, density=density)
    xyz, cloud = scene.cloud.coordinates(), scene.cloud
    for k in range(files):
        las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
        las.header.scales, las.header.offsets = np.full(3, 0.01), np.zeros(3)
        las.x, las.y, las.z = xyz[:, 0] + SIDE * (k // 4), xyz[:, 1] + SIDE * (k % 4), xyz[:, 2]
        las.return_number, las.number_of_returns = cloud.return_number, cloud.number_of_returns
        las.write(folder / f"{k // 4}-{k % 4}.laz")


def states(folder: Path) -> dict[str, tuple[str, int]]:
    """Digest and time of every file."""
    return {
        p.name: (hashlib.sha256(p.read_bytes()).hexdigest(), p.stat().st_mtime_ns) for p in sorted(folder.glob("*.laz"))
    }


def main(arguments: list[str] | None = None) -> None:
    """Both commands, and which files have changed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, default=HERE / "out" / "speed", help="folder for the files [%(default)s]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the figures [%(default)s]")
    parser.add_argument("--files", type=int, default=16)
    parser.add_argument("--density", type=float, default=2.1, help="pulses per m2 [%(default)s]")
    options = parser.parse_args(arguments)
    files, classified, places = options.work / "survey", options.work / "classified", options.work / "places.gpkg"
    if not files.exists():
        survey(files, options.files, options.density)
    command = [*COMMAND, str(files), str(classified), "--review", str(places), "--units", "m", "--json", "--overwrite"]
    verdicts = options.work / "verdicts.gpkg"
    turns: list[tuple[dict[str, float], dict[str, float]]] = []
    for turn in range(-1, TURNS):  # once before, so that no time contains compilation
        shutil.rmtree(classified, ignore_errors=True)
        ground = watched(command)
        table = geopandas.read_file(places)
        right = table[table["area"] <= MOST].copy()
        east = jf.open(files, units="m").bounds[2]
        right = right[right.bounds["maxx"] < east - SIDE - RIM].head(VERDICTS)  # none in the files of the last column
        right["verdict"] = np.where(np.arange(len(right)) % 2 == 0, "object", "ground")
        right.to_file(verdicts, layer="review")
        before = states(classified)
        apply = watched([*COMMAND[:-1], "apply", str(verdicts), str(classified), "--units", "m", "--json"])
        print(ground, apply, file=sys.stderr, flush=True)
        if turn >= 0:
            turns.append((ground, apply))
    after = states(classified)
    changed = sum(after[name] != before[name] for name in before)
    untouched = [name for name in before if name.startswith(f"{options.files // 4 - 1}-")]
    assert all(after[name] == before[name] for name in untouched), "files without a verdict"
    area, keep = right["area"].sum(), len(before) - changed
    medians = [
        {key: float(np.median([one[key] for one in own])) for key in ("cpu", "wall", "peak")}
        for own in zip(*turns, strict=True)
    ]
    shares = sorted(100 * apply["cpu"] / ground["cpu"] for ground, apply in turns)
    lines = [
        "# Time of verdicts\n",
        f"{ground['points']:,} points in {len(before)} files, {len(right)} verdicts on {area:,.0f} m2. Medians of {TURNS} turns, "
        "one after the other, warm.\n",
        "| | CPU seconds | seconds | peak memory, GB |",
        "|---|---:|---:|---:|",
        *(
            f"| `jaxfilter {name}` | {one['cpu']:.1f} | {one['wall']:.1f} | {one['peak']:.2f} |"
            for name, one in zip(("ground", "apply"), medians, strict=True)
        ),
        f"\n`apply` takes {np.median(shares):.1f} % of the CPU time of `ground` ({shares[0]:.1f} to {shares[-1]:.1f}). {changed} "
        f"files have changed, and {keep} keep their bytes and times, among them all {len(untouched)} without a verdict.",
    ]
    write_page(options.out / "speed.md", "\n".join(lines), "python experiments/verdicts/speed.py")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
