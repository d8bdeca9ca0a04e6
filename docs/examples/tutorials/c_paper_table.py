"""
A paper's table in ten lines
============================

A table of methods by samples, with means, significance, and LaTeX.
"""

import jaxfilter as jf

clouds = {
    f"town {seed}": jf.scenes.make("town", size=(90, 80), density=1.3, seed=seed).cloud
    for seed in (4, 5, 6)
}
outcome = jf.compare(["smrf", "pmf", "fptd"], clouds)
print(outcome.by_method("total").round(2))
print(outcome.by_method("kappa").mean().round(2))

# %%
# Is a difference more than chance? Wilcoxon's signed-rank test over the clouds, corrected for the number of pairs. Three
# clouds are too few to say:

outcome.significance("total")[
    ["method", "other", "clouds", "difference", "p", "p_holm"]
]

# %%
# For the manuscript, with the package booktabs:

print(outcome.latex())

# %%
# The samples of ISPRS
# --------------------
#
# The same on the 15 labelled samples that most papers use (columns x, y, z, label). Their licence does not let us bring them
# along, so this block is not run here:
#
# .. code-block:: python
#
#     samples = {f"samp{n}": jf.read(f"isprs/samp{n}.txt", units="m") for n in (11, 12, 21, 22, 23, 24, 31)}
#     outcome = jf.compare(["ost", "smrf", "fptd", "csf"], samples)
#     print(outcome.by_method("total").mean())
#
# Stored output, of ``experiments/isprs/run.py``, which does this for all methods (:doc:`/docs/results/README`):
#
# .. image:: /experiments/isprs/results/figures/totals.png
#    :alt: Total errors of every method on the 15 samples.

# sphinx_gallery_thumbnail_path = 'experiments/isprs/results/figures/time.png'
