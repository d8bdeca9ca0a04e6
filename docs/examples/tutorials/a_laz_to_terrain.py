"""
From LAZ to a terrain model
===========================

A file is read, its ground is found, labels go back into a file, and a raster of the terrain is made. The command line does
the same: ``jaxfilter ground in.laz out.laz``, then ``jaxfilter dtm out.laz dtm.tif``.
"""

import tempfile
from pathlib import Path

import laspy
import numpy as np

import jaxfilter as jf

folder = Path(tempfile.mkdtemp())

# %%
# So that everything can be checked, the file is a simulated survey. With your own data, begin at the next step.

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
las = laspy.create(point_format=6, file_version="1.4")
las.header.scales, las.header.offsets = (
    np.full(3, 0.01),
    np.floor(scene.xyz.min(axis=0)),
)
las.xyz, las.return_number, las.number_of_returns = (
    scene.xyz,
    scene.return_number,
    scene.number_of_returns,
)
las.write(str(folder / "site.laz"))

# %%
# Read
# ----
#
# A cloud holds coordinates, echoes and classes. Points that no filter should judge (noise, water, bridge decks, withheld
# points, all but last echoes) are set aside. The file says no unit, so we do.

cloud = jf.read(folder / "site.laz", units="m")
cloud

# %%
# Find the ground
# ---------------
#
# The default filter needs no choice. A result has labels, and the quantities behind them.

result = jf.default_filter(cloud)(cloud)
print(result)
result

# %%
# A section through the middle shows what was taken for ground:

ax = jf.plots.profile(cloud, result, ((0.0, 35.0), (88.0, 35.0)), width=2.0)

# %%
# Write the labels
# ----------------
#
# Ground becomes class 2, what was judged and is not ground becomes class 1; all else in the file stays as it was.
# ``extra`` adds quantities as extra dimensions.

jf.write(folder / "classified.laz", cloud, result, extra=("height", "doubt"))
written = laspy.read(folder / "classified.laz")
print(np.unique(written.classification, return_counts=True))
print(list(written.point_format.extra_dimension_names))

# %%
# The terrain
# -----------
#
# ``dtm`` makes a raster through the ground points. ``raster.write("dtm.tif")`` saves it as GeoTIFF.

raster = jf.dtm(cloud, result, cell=1.0)
print(raster.values.shape, raster.bounds)
ax = jf.plots.hillshade(cloud.xyz[result.ground], title="the ground")

# %%
# How good is it?
# ---------------
#
# Here the truth is known, at every point and at every place of the terrain:

print(jf.evaluate(result, scene.truth, candidates_only=True))
x, y = raster.centres()
error = raster.values - scene.terrain(x[None, :], y[:, None])
print(f"the terrain is off by {np.nanmedian(np.abs(error)):.3f} m in the median")

# %%
# With data of your own, ``jf.report(cloud, result, "site.html")`` makes a page to check the labels in:
# :doc:`/docs/reports`.
