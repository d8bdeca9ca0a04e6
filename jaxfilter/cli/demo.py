"""The command ``demo``: a simulated scene, filtered, scored and drawn."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import click

from .commands import main
from .output import print_json, print_report, run_report
from .session import BadUsage, Session, session_options

if TYPE_CHECKING:
    from ..core.result import FilterResult
    from ..scenes import Scene

DEMO_FILES = ("scene.laz", "scene_truth.laz", "scene_ground.laz", "truth.png", "result.png", "errors.png", "panel.png")


@main.command()
@click.argument(
    "directory", metavar="[DIR]", default="jaxfilter-demo", type=click.Path(file_okay=False, path_type=Path)
)
@click.option(
    "--size", nargs=2, type=float, default=(400.0, 300.0), show_default=True, metavar="WIDTH HEIGHT", help="Metres."
)
@click.option("--density", type=float, default=1.5, show_default=True, help="Pulses per m2.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--method", metavar="METHOD", help="Filter by this method.  [default: the default filter]")
@click.option("--overwrite", is_flag=True, help="Write into DIR even if it holds other files.")
def demo(
    directory: Path,
    size: tuple[float, float],
    density: float,
    seed: int,
    method: str | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    debug: bool,
) -> None:
    """Make a scene whose ground is known, filter it, score the result and draw it.

    Writes into DIR (by default jaxfilter-demo): scene.laz, scene_truth.laz, scene_ground.laz, and pictures of
    the true ground, of the filtered ground, of the errors, and of all three.
    """
    from .. import scenes
    from ..files.disk import remove_dead
    from ..files.reading import read, write
    from ..methods import FILTERS
    from ..methods.default import default_filter
    from ..scoring import evaluate as score

    with Session(quiet=quiet, debug=debug) as session:
        if directory.is_dir():
            remove_dead(directory)
        others = sorted(p.name for p in directory.glob("*") if p.name not in DEMO_FILES)
        if others and not overwrite:
            raise BadUsage(f"{directory} holds other files ({others[0]}): name another folder, or pass --overwrite")
        if method is not None and method not in FILTERS:
            raise BadUsage(f"no method {method!r}: choose one of {', '.join(FILTERS)}")
        with session.step("scene"):
            scene = scenes.make("mixed", size=size, density=density, seed=seed)
            _write_scene(directory, scene)
        with session.reading(directory / "scene.laz"):
            cloud = read(directory / "scene.laz", progress=session.progress)
        filter_ = FILTERS[method].preset("recommended") if method else default_filter(cloud)
        with session.step("filter", len(cloud)):
            result = filter_(cloud, progress=session.progress)
        with session.step("write"):
            target = write(directory / "scene_ground.laz", cloud, result, overwrite=True)
        scores = score(result, scene.truth, candidates_only=True)
        with session.step("pictures"):
            _draw(directory, scene, result)
    report = run_report(filter_, result, session) | {"output": str(target)}
    if as_json:
        print_json(report | {"scores": scores.as_dict(), "files": [str(directory / name) for name in DEMO_FILES]})
    elif not quiet:
        print_report(report)
        click.echo(scores)
        click.echo(f"in {directory}: {', '.join(DEMO_FILES)}")


def _write_scene(directory: Path, scene: Scene) -> None:
    """The scene as delivered (never classified), and with its true classes. The CRS is one that its coordinates fit."""
    import numpy as np

    from ..files.reading import write

    directory.mkdir(parents=True, exist_ok=True)
    nothing = np.zeros(len(scene), bool)
    cloud = dataclasses.replace(scene.cloud, crs="EPSG:25832")
    write(directory / "scene.laz", cloud, nothing, reset="none", overwrite=True)
    classified = dataclasses.replace(cloud, classification=scene.classes)
    write(directory / "scene_truth.laz", classified, nothing, reset="none", overwrite=True)


def _draw(directory: Path, scene: Scene, result: FilterResult) -> None:
    from .. import plots
    from ..files.disk import new_file

    cloud, truth = scene.cloud, scene.truth
    terrain = scene.terrain_grid(1.0)
    found = plots.rasterise(cloud.xyz[result.ground], terrain[1].cell, over=cloud.xyz)
    pictures = {
        "truth.png": plots.hillshade(terrain, title="true terrain").figure,
        "result.png": plots.hillshade(found, title="filtered ground").figure,
        "errors.png": plots.error_map(cloud, result, truth, surface=terrain, title="errors").figure,
        "panel.png": plots.panel(cloud, result, truth),
    }
    for name, figure in pictures.items():
        with new_file(directory / name, overwrite=True) as part:
            figure.savefig(part, format="png")


demo.params += session_options()
