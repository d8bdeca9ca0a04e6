"""What the scripts of this folder share: their options, the samples, and how a page is written."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import jaxfilter as jf
from experiments.isprs import samples
from experiments.report import Row, write_csv, write_page

HERE = Path(__file__).parent


class Study:
    """A script with its command line. ``defaults``: what else may be given, by name."""

    def __init__(self, script: str, text: str | None, arguments: list[str] | None, **defaults: int) -> None:
        given = sys.argv[1:] if arguments is None else arguments
        parser = argparse.ArgumentParser(description=text)
        parser.add_argument("--data", type=Path, help="folder with isprs/ [JAXFILTER_DATA]")
        parser.add_argument("--out", type=Path, default=HERE / "out", help="folder for the results [%(default)s]")
        parser.add_argument(
            "--samples", type=samples.sample_name, nargs="+", default=samples.SAMPLES, help="such as 11 24"
        )
        for name, value in defaults.items():
            parser.add_argument(f"--{name}", type=int, default=value, help="[%(default)s]")
        self.options = parser.parse_args(given)
        self.options.out.mkdir(parents=True, exist_ok=True)
        self.folder = samples.data_folder(self.options.data)
        self.command = shlex.join(["python", f"experiments/sensitivity/{script}.py", *given])

    def clouds(self) -> dict[str, jf.PointCloud]:
        """The ISPRS samples."""
        return {f"samp{n}": jf.read(samples.sample_path(self.folder, n)) for n in self.options.samples}

    def write(self, name: str, text: Sequence[str], rows: Sequence[Row], methods: Iterable[str] = ()) -> None:
        """A page of paragraphs and tables, and its rows."""
        write_csv(self.options.out / f"{name}.csv", rows)
        write_page(self.options.out / f"{name}.md", "\n\n".join(text), self.command, methods)
        print(f"results are in {self.options.out}")
