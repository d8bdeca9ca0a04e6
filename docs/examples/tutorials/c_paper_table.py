"""
A paper's table in 25 lines
===========================

A filter of one's own, all others beside it, the 15 samples of ISPRS, significance, a figure, and LaTeX.
"""

# %%
# A filter of one's own
# ---------------------
#
# One opening of the lowest elevations, filled; ground is what lies within a tolerance of it.
# :doc:`/docs/adding_a_filter` says what else a method may declare.

import numpy as np

import jaxfilter as jf
from jaxfilter.core.params import filter_params, param
from jaxfilter.engines.grid import inpaint, morphology
from jaxfilter.steps.grid_filter import Heights, LowOutlierFilter, Surface


@filter_params
class TopHat(LowOutlierFilter):
    threshold: float = param("tolerance", ">= 0 m", default=0.5)

    def surface(self, cells):
        filled = inpaint.fill_membrane(cells.lowest, cells.seen, cells.valid).z
        opened = morphology.opening(filled, 15, 15, valid=cells.valid)
        return Surface.over(cells, opened)

    def test(self, surface, xyz):
        height, slope = surface.at(xyz)
        return Heights(height, slope, height - self.threshold, -height - self.threshold)


# %%
# All methods on all samples
# --------------------------
#
# Their licence does not let us bring the samples along. Where ``JAXFILTER_DATA`` names a folder that holds
# ``isprs/samp11.txt`` and the rest, they are taken, and six simulated towns where it does not.

try:
    data = jf.datasets.folder("isprs")
except jf.InputError:
    data = {
        f"town {seed}": jf.scenes.make("town", size=60, density=1, seed=seed).cloud
        for seed in range(6)
    }
outcome = jf.compare({m.upper(): m for m in jf.FILTERS}, data, repeats=0, cell=None)

# %%
# Is the new one better?
# ----------------------
#
# Wilcoxon's signed-rank test over the clouds, corrected for the number of methods (Holm). The effect is the matched-pairs
# rank-biserial correlation: 1 = the other method is better on every cloud, -1 = worse on every cloud. Samples of one site
# are no independent witnesses: with ``groups={"samp11": "site 1", ...}`` of ``compare`` and ``by="group"`` here the means of
# sites are tested.

outcome.significance("total", against="TOPHAT").round(3)

# %%
# The figure, and the table for the manuscript (with the package booktabs):

ax = outcome.by_method("total").plot.box(rot=90, ylabel="total error (%)")
print(outcome.latex("total"))

# %%
# Labels of a network, or of another program, and the table of the literature
# ---------------------------------------------------------------------------
#
# Labels of each cloud are a method as well: arrays (True or 1 = ground, or scores from 0 to 1, of which those of 0.5 and more are
# ground), or files: arrays as ``.npy``, points with labels as LAS, LAZ or text, results that ``FilterResult.save`` has written.
# They are a list like the clouds, or a mapping from their names. Here a result stands in for those of a network: the score of a
# point falls with its height above the cloth of CSF.

scores = {}
for name in data:
    height = np.nan_to_num(jf.CSF()(data[name]).height, nan=np.inf)
    scores[name] = 1 / (1 + np.maximum(height, 0) / 0.4)

# %%
# Several scores stand side by side for each method, a row for each cloud. Below are the means of groups, such as terrain classes,
# and of all. ``latex`` writes the same for the manuscript.

groups = {name: "sites 1 to 4" if name < "samp5" else "other sites" for name in data}
beside = jf.compare(
    {"network": scores, "SMRF": "smrf"}, data, groups=groups, repeats=0, cell=None
)
print(beside.markdown(["type1", "type2", "total", "kappa"]))

# %%
# What a table stands on is kept with it: the version of the library, and a digest of each cloud. A single result has its
# parameters and random key as well, and comes back bit for bit from the file of ``save``.

print(list(beside.provenance), beside.provenance["clouds"][min(data)])
result = jf.SMRF()(data[min(data)])
path = result.save("smrf.npz", overwrite=True)
print(jf.FilterResult.load(path).provenance)
path.unlink()

# %%
# Parameters that were chosen on the samples they are scored on flatter a method. Of a list of filters each cloud, or each
# group, gets the one that is best on all *others*.

sets = [TopHat(threshold=value) for value in (0.3, 0.5, 1.0)]
some = {name: data[name] for name in list(data)[:6]}
chosen = jf.compare(
    {"TopHat, chosen": sets, "SMRF": "smrf"}, some, repeats=0, cell=None
)
chosen.by_method("total").round(2)

# %%
# Measured results of all methods on the samples: :doc:`/experiments/isprs/results/results`.

# sphinx_gallery_thumbnail_path = 'experiments/isprs/results/figures/time.png'
jf.FILTERS.pop("tophat")  # other pages list the methods of the library
