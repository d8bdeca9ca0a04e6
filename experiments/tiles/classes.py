"""High noise and vegetation on labelled tiles, with the ground of their producers: what is found, and what it should be.

    python experiments/tiles/classes.py [FOLDER ...]

By default the folders tiles, tiles_hard and isprs_sites of JAXFILTER_DATA. Prints a table.
"""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.report import markdown
from jaxfilter.files.classes import classes_of
from jaxfilter.steps.high_noise import isolated_above

LEAST = 1000
"""Points of a class that a share is made of."""


def row(path: Path) -> dict[str, Any]:
    """High noise, and the shares of buildings and of all else above 2 m that become vegetation, in percent."""
    cloud = jf.read(path, units="m", returns="all", ignore_classes=())
    high = isolated_above(cloud)
    old = np.zeros(len(cloud), np.uint8) if cloud.classification is None else cloud.classification
    found: dict[str, Any] = {"tile": path.stem, "points": len(cloud), "high": int(high.sum())}
    found["of_classes"] = ", ".join(map(str, np.unique(old[high])))
    if not (ground := old == 2).any():
        return found
    echoes = {"return_number": cloud.return_number, "number_of_returns": cloud.number_of_returns}
    bare = jf.PointCloud.from_arrays(cloud.coordinates(), **echoes)  # without what the producer knew
    plants = np.isin(classes_of(bare, ground, jf.Classes(vegetation=(0.5, 2.0, 5.0))), (3, 4, 5))
    above = jf.height_above_ground(bare, ground) > 2
    for name, some in (("roofs", old == 6), ("others", above & np.isin(old, (1, 4, 5)))):
        if some.sum() > LEAST:
            found[name] = 100 * float(plants[some].mean())
    return found


def main() -> None:
    """Print the table."""
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    data = Path(os.environ.get("JAXFILTER_DATA", "../shared/data"))
    folders = [Path(name) for name in sys.argv[1:]] or [data / name for name in ("tiles", "tiles_hard", "isprs_sites")]
    rows = [row(path) for folder in folders for path in sorted(folder.glob("*.la[sz]"))]
    columns = [
        ("tile", "tile", ""),
        ("points", "points", ",d"),
        ("high", "high noise", ",d"),
        ("of_classes", "its classes", ""),
    ]
    shares = [("roofs", "buildings as vegetation, %", ".1f"), ("others", "classes 1, 4, 5 above 2 m, %", ".1f")]
    print(markdown([*columns, *shares], [dict.fromkeys(("roofs", "others")) | one for one in rows]))


if __name__ == "__main__":
    main()
