"""
From one tile to a country
==========================

Files of a survey are filtered in tiles that see their surroundings, so that no seams remain. This page does it with four
small files; :doc:`/docs/from_one_tile_to_a_country` says how runs are planned, stopped, resumed and spread over machines.
"""

import tempfile
from pathlib import Path

import laspy
import numpy as np
import pyproj

import jaxfilter as jf

folder = Path(tempfile.mkdtemp())

# %%
# A town in four files of 45 x 40 m:

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
(folder / "survey").mkdir()
column, row = (
    np.floor((scene.xyz[:, :2] - scene.origin[:2]) / (45.0, 40.0))
    .astype(int)
    .T.clip(0, 1)
)
for part in range(4):
    mine = 2 * row + column == part
    las = laspy.create(point_format=6, file_version="1.4")
    las.header.scales, las.header.offsets = np.full(3, 0.01), scene.origin
    las.header.add_crs(pyproj.CRS(25832))
    las.xyz = scene.xyz[mine]
    las.return_number, las.number_of_returns = (
        scene.return_number[mine],
        scene.number_of_returns[mine],
    )
    las.write(str(folder / "survey" / f"{part}.laz"))

# %%
# Look
# ----
#
# Only headers are read. ``check`` says what does not fit together.

survey = jf.open(folder / "survey")
print(survey)
print("\n".join(survey.check().lines()))
ax = survey.plot()

# %%
# Filter
# ------
#
# In tiles of 45 m, each with what lies around it. By default so few points are one tile, and of larger data there are as many
# processes as the machine has cores. They import the script anew: in a file of your own, put the call under
# ``if __name__ == "__main__":``. On the command line it is ``jaxfilter ground smrf survey/ classified/``.

report = jf.ground(
    folder / "survey",
    folder / "classified",
    jf.SMRF(),
    run=jf.RunOptions(tile=45.0, wide_halos=True, workers=1),
)
print(
    f"{report.tiles} tiles, {len(report.files)} files, {report.ground:,} of {report.points:,} points are ground"
)

# %%
# The labels are those of the whole town in one piece:

whole = jf.SMRF()(scene.cloud).ground
labels = np.zeros(len(scene), bool)
for part in range(4):
    mine = 2 * row + column == part
    labels[mine] = laspy.read(folder / "classified" / f"{part}.laz").classification == 2
print(f"{(labels != whole).sum()} of {len(whole)} labels differ")
