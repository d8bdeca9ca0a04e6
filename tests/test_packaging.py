"""What is shipped: versions that agree, dependencies and extras that are used, a light source distribution."""

import ast
import datetime
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
from click.shell_completion import ShellComplete
from fsspec.registry import _registry

import jaxfilter as jf
from jaxfilter.cli import main
from jaxfilter.surveys.dask import Cluster

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
RECIPE = (ROOT / "recipe" / "recipe.yaml").read_text()
CONDA = {"lazrs-python": "lazrs", "matplotlib-base": "matplotlib", "dask-core": "dask", "geopandas-base": "geopandas"}
"""Names of packages in conda-forge that are others on PyPI."""
PARTS = {"lazrs", "distributed"}
"""What comes with an extra of another package: laspy[lazrs], dask[distributed]."""
BY_OTHERS = {"s3fs", "aiohttp", "jinja2"}
"""What fsspec imports for s3:// and https://, and pandas for LaTeX."""
PUBLISHED = ("natural", "cluster", "remote")


def bounds(requirements):
    """Lowest versions by name."""
    return {m[1]: m[2] for m in (re.match(r"([\w.-]+)(?:\[\w+\])?>=([\d.]+)", text) for text in requirements) if m}


def imported():
    """Every package that a module of the library imports."""
    found = set()
    for path in Path(jf.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add((node.module or "").split(".")[0])
    return found


def test_versions_agree():
    version = jf.__version__
    cff = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {version}\n" in cff and f'\n  version: "{version}"\n' in RECIPE
    released = re.search(rf"\n## \[{re.escape(version)}\] - (\S+)\n", (ROOT / "CHANGELOG.md").read_text())
    assert datetime.date.fromisoformat(released[1]).isoformat() in cff


def test_the_conda_recipe_asks_for_what_pyproject_asks_for():
    _, run, extras = (
        dict(re.findall(r"- ([\w-]+) >=([\d.]+)", part))
        for part in re.split(r"\n  (?:run|run_constraints):", RECIPE.partition("requirements:")[2].partition("\ntests:")[0])
    )  # fmt: skip
    ours = {name: CONDA.get(name, name) for name in (*run, *extras)}
    wanted = bounds(PROJECT["dependencies"])
    assert {ours[name]: version for name, version in run.items() if ours[name] not in PARTS} == wanted
    optional = bounds([text for name in PUBLISHED for text in PROJECT["optional-dependencies"][name]])
    assert {ours[name]: version for name, version in extras.items() if ours[name] not in PARTS} == optional
    assert PROJECT["requires-python"] == ">=" + re.search(r'python_min: "([\d.]+)"', RECIPE)[1]


def test_the_conda_recipe_is_rendered_by_its_builder():
    """It refuses unknown fields; channels are not asked."""
    rattler = pytest.importorskip(
        "rattler_build", reason="py-rattler-build is not installed: the recipe is not rendered"
    )
    (variant,) = rattler.Stage0Recipe.from_file(str(ROOT / "recipe" / "recipe.yaml")).render(rattler.VariantConfig())
    made = variant.recipe.to_dict()
    assert made["package"] == {"name": "jaxfilter", "version": jf.__version__}
    assert made["build"]["noarch"] == "python"
    commands = [f"{name} = {place}" for name, place in PROJECT["scripts"].items()]
    assert made["build"]["python"]["entry_points"] == commands
    assert made["source"][0]["path"] == f"../dist/jaxfilter-{jf.__version__}.tar.gz"
    assert made["about"]["license"] == PROJECT["license"] and (ROOT / made["about"]["license_file"][0]).exists()
    assert len(made["requirements"]["run"]) > len(PROJECT["dependencies"])


def test_dependencies_and_extras_are_used():
    used = imported() | BY_OTHERS
    extras = PROJECT["optional-dependencies"]
    for text in [*PROJECT["dependencies"], *(text for name in PUBLISHED for text in extras[name])]:
        name = re.match(r"[\w.-]+", text)[0]
        assert name in used or f"{name}[" in text, f"nothing imports {name}"
    assert set(re.findall(r"\w+", extras["all"][0])) - {"jaxfilter"} == set(PUBLISHED)
    installed = {re.match(r"\w+", text)[0] for text in PROJECT["dependencies"]}
    rest = imported() - set(sys.stdlib_module_names) - installed - {"jaxfilter", "lazrs", "mpl_toolkits", "shapely"}
    assert rest == {"startinpy", "distributed"}, "GeoTIFF, GeoPackage and pictures come with the plain install"


PLANE = jf.PointCloud.from_arrays(np.eye(3))


@pytest.mark.parametrize("library, extra, error, call", [
    ("startinpy", "natural", ImportError, lambda: jf.dtm(PLANE, np.ones(3, bool), method="natural")),
    ("distributed", "cluster", ImportError, lambda: Cluster("tcp://127.0.0.1:1")),
    ("s3fs", "remote", jf.InputError, lambda: jf.read("s3://bucket/in.laz")),
])  # fmt: skip
def test_a_missing_extra_is_named(monkeypatch, library, extra, error, call):
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delitem(_registry, "s3", raising=False)  # of an earlier test
    with pytest.raises(error, match=rf"pip install 'jaxfilter\[{extra}\]'"):
        call()


def test_the_source_distribution_is_light_and_the_wheel_typed(tmp_path):
    from hatchling.builders.sdist import SdistBuilder
    from hatchling.builders.wheel import WheelBuilder

    source = Path(next(SdistBuilder(str(ROOT)).build(directory=str(tmp_path))))
    assert source.stat().st_size < 1_000_000
    with tarfile.open(source) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    shipped = {f"jaxfilter/{name}" for name in ("py.typed", "methods/papers.bib", "reports/page.html")}
    assert shipped | {"README.md", "LICENSE", "CITATION.cff", "pyproject.toml"} <= names
    assert not any(name.startswith(("tests/", "docs/", "experiments/", "qgis/")) for name in names)
    wheel = WheelBuilder(str(ROOT))
    with zipfile.ZipFile(next(wheel.build(directory=str(tmp_path)))) as archive:
        assert shipped <= set(archive.namelist())
    metadata = wheel.metadata.core
    assert metadata.version == jf.__version__ and "Typing :: Typed" in metadata.classifiers


def test_it_runs_as_a_module():
    done = subprocess.run([sys.executable, "-m", "jaxfilter", "--version"], capture_output=True, text=True)
    assert done.stdout == f"jaxfilter, version {jf.__version__}\n", done.stderr
    done = subprocess.run([sys.executable, "-m", "jaxfilter", "evaluate"], capture_output=True, text=True)
    assert done.returncode == 2 and "Usage: jaxfilter evaluate" in done.stderr


def test_the_shell_completes_commands_methods_and_flags():
    complete = ShellComplete(main, {}, "jaxfilter", "_JAXFILTER_COMPLETE")

    def words(*before, last):
        return {item.value for item in complete.get_completions(list(before), last)}

    assert words(last="con") == {"contours"}
    assert words("ground", last="sm") == {"smrf"}
    assert words("ground", "smrf", "in.laz", "out.laz", last="--sc") == {"--scaling", "--scheduler"}
