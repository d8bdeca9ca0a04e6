"""The ISPRS WG III/3 data: where they are, which terrain class each cloud was given, and what was published on them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import jaxfilter as jf
from experiments.report import Row, read_csv

HERE = Path(__file__).parent
os.environ.setdefault("JAXFILTER_DATA", str(HERE.parents[2] / "shared" / "data"))
SAMPLES = ("11", "12", "21", "22", "23", "24", "31", "41", "42", "51", "52", "53", "54", "61", "71")
SITES = ("CSite1", "CSite2", "CSite3", "CSite4", "FSite5", "FSite6", "FSite7", "FSite8")


def published(table: str) -> list[Row]:
    """A table of published figures, by the name of its file in ``published/``."""
    return read_csv(HERE / "published" / f"{table}.csv")


def terrain_classes() -> dict[str, str]:
    """The terrain class, D1 to D4, that Li et al. (2021), Table I, give each sample and site."""
    return {row["cloud"]: row["terrain"] for row in published("li2021_table1")}


def data_folder(given: Path | None) -> Path:
    """The folder with the data, as of ``jf.datasets.home``. Raises: SystemExit saying how to get the data."""
    try:
        folder = jf.datasets.home(given)
    except jf.InputError as error:
        raise SystemExit(str(error)) from None
    if not (folder / "isprs").is_dir():
        raise SystemExit(f"{folder} has no folder 'isprs' with the reference samples. {jf.datasets.HOW_TO_GET}")
    return folder


def sample_path(folder: Path, sample: str) -> Path:
    """The file of a sample such as "11". Raises: SystemExit."""
    path = folder / "isprs" / f"samp{sample}.txt"
    if not path.is_file():
        raise SystemExit(f"{path} is missing. {jf.datasets.HOW_TO_GET}")
    return path


def site_path(folder: Path, site: str) -> Path | None:
    """The densest file of a site, or None if there is none."""
    files = list((folder / "isprs_sites").glob(f"{site}*.laz"))
    return max(files, key=lambda path: path.stat().st_size, default=None)


def sample_name(text: str) -> str:
    """ "11" of "11", "s11" or "samp11". Raises: ValueError."""
    number: Any = text.lower().removeprefix("samp").removeprefix("s")
    if number not in SAMPLES:
        raise ValueError(f"no sample {text!r}; there are {', '.join(SAMPLES)}")
    return number
