"""Other programs for the same job, where they are installed: the command that each is run by."""

from __future__ import annotations

import importlib.util
import shutil
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
PCL = "pcl_progressive_morphological_filter"
ALL = ("csf_wheel", "pdal_smrf", "pdal_pmf", "pcl_pmf")


def installed() -> list[str]:
    """Names of the peers that this machine has."""
    pdal = shutil.which("pdal") is not None
    there = (importlib.util.find_spec("CSF") is not None, pdal, pdal, shutil.which(PCL) is not None)
    return [name for name, has in zip(ALL, there, strict=True) if has]


def command(peer: str, source: Path, target: Path) -> list[str]:
    """Arguments of a peer with its default parameters, from LAS to LAS (PCL: from PCD to PCD)."""
    if peer == "csf_wheel":
        return [sys.executable, str(HERE / "csf_wheel.py"), str(source), str(target)]
    if peer.startswith("pdal_"):
        return ["pdal", "translate", str(source), str(target), peer.removeprefix("pdal_")]
    return [
        PCL, str(source.with_suffix(".pcd")), str(target.with_suffix(".pcd")),
        "-max_window_size", "33", "-slope", "1.0", "-max_distance", "2.5", "-initial_distance", "0.15", "-cell_size", "1",
        "-base", "2", "-exponential", "1",
    ]  # fmt: skip


def write_pcd(path: Path, xyz: np.ndarray) -> None:
    """Coordinates f32[n, 3] as a binary PCD file."""
    n = len(xyz)
    header = (
        f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {n}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n"
    )
    path.write_bytes(header.encode() + np.ascontiguousarray(xyz, "<f4").tobytes())
