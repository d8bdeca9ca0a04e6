"""The command ``demo``: a simulated scene, filtered, scored and drawn."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from .commands import command
from .options import take_run
from .output import Answer, report_text, run_facts
from .session import BadUsage, Session
from .values import FOLDER, SEED, option

if TYPE_CHECKING:
    from ..scenes import Scene

CLOUDS = ("scene.laz", "scene_truth.laz", "scene_ground.laz")
PICTURES = ("before", "truth", "result", "errors", "panel")
DEMO_FILES = (*CLOUDS, *(f"{name}.png" for name in PICTURES))


@command(
    click.Argument(["directory"], metavar="[DIR]", default="jaxfilter-demo", type=FOLDER),
    option("--size", "Width and height of the scene, metres.", float, nargs=2, default=(400.0, 300.0)),
    option("--density", "Number of pulses per m2.", float, default=1.5),
    option("--seed", "Seed of the scene.", SEED, default=0),
    option("--method", "Filter by this method.  [default: the default filter]", "METHOD"),
    option("--overwrite", "Write into DIR even if it holds other files.", bool),
)
def demo(session: Session, directory: Path, method: str | None, overwrite: bool, **survey: Any) -> Answer:
    """Filter a scene whose ground is known, and draw the result.

    The folder DIR gets scene.laz, scene_truth.laz and scene_ground.laz, and pictures of the points, of the true ground, of the
    ground that was found, of the errors, and of all four. Errors less than a metre high have a colour of their own; most are
    low plants.
    """
    from .. import scenes
    from ..core.output import UNFINISHED
    from ..files.reading import read
    from ..scoring import evaluate as score
    from ..surveys.ground import ground
    from ..surveys.measures import Recipe
    from .flags import method_of

    there = [place for place in directory.glob("*") if not place.name.startswith(UNFINISHED)]
    others = sorted(place.name for place in there if place.name not in DEMO_FILES or place.is_symlink())
    if others and not overwrite:
        raise BadUsage(f"{directory} holds other files ({others[0]}): name another folder, or pass --overwrite")
    recipe = Recipe() if method is None else Recipe(method_of(method), preset="recommended")
    with session.step("scene"):
        scene = scenes.make("mixed", **survey)
        _write_scene(directory, scene)
    run, target = take_run({"overwrite": True}, session), directory / "scene_ground.laz"
    with session.step("run", len(scene)):
        report = ground(directory / "scene.laz", target, recipe, run=run)
    classes = read(target).classification
    assert classes is not None
    labels = classes == 2
    scores = score(labels, scene.truth, ignore=~scene.cloud.candidate)
    with session.step("pictures"):
        _draw(directory, scene, labels)
    facts = run_facts(session, report) | {"output": str(target)}
    files = [str(directory / name) for name in DEMO_FILES]
    text = f"{report_text(facts)}\n{scores}\nin {directory}: {', '.join(DEMO_FILES)}"
    return Answer(facts | {"scores": scores.as_dict(), "files": files}, text)


def _write_scene(directory: Path, scene: Scene) -> None:
    """The scene as delivered (never classified), and with its true classes. The CRS is one that its coordinates fit."""
    from ..files.reading import write

    directory.mkdir(parents=True, exist_ok=True)
    nothing = np.zeros(len(scene), bool)
    for name, classes in (("scene.laz", scene.cloud.classification), ("scene_truth.laz", scene.classes)):
        cloud = dataclasses.replace(scene.cloud, crs="EPSG:25832", classification=classes)
        write(directory / name, cloud, nothing, reset="none", overwrite=True)


def _draw(directory: Path, scene: Scene, ground: np.ndarray) -> None:
    from .. import plots
    from ..files.disk import new_file

    cloud, truth = scene.cloud, scene.truth
    terrain = scene.terrain_grid(1.0)
    found = plots.rasterise(cloud.xyz[ground], terrain[1].cell, over=cloud.xyz)
    figures = (
        plots.hillshade(plots.maps.top_of(cloud, terrain[1].cell), title="all points, before").figure,
        plots.hillshade(terrain, title="true terrain").figure,
        plots.hillshade(found, title="filtered ground").figure,
        plots.error_map(cloud, ground, truth, surface=terrain, title="errors").figure,
        plots.panel(cloud, ground, truth, surface=terrain),
    )
    for name, figure in zip(PICTURES, figures, strict=True):
        with new_file(directory / f"{name}.png", overwrite=True) as part:
            figure.savefig(part, format="png")
