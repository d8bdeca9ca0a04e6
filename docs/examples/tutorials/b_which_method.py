"""
Which method, and which parameters
==================================

``jf.default_filter`` needs no choice. Another method is worth a thought where it is known to suit the terrain, where a paper
is compared with, or where speed counts. :doc:`/docs/choosing_a_filter` has figures on real data; here is how to get those
of your own.
"""

import matplotlib.pyplot as plt

import jaxfilter as jf

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
cloud = scene.cloud

# %%
# Several methods, one table
# --------------------------
#
# A name is taken with ``for_cloud``: its defaults, and what follows from the point spacing. A filter is taken as it is.

outcome = jf.compare(
    {"OST": "ost", "SMRF": "smrf", "FPTD": "fptd", "FPTD, D1": jf.FPTD.preset("D1")},
    cloud,
)
outcome.by_method("total").round(2)

# %%
# What they get wrong tells more than how much. All leave low plants in the ground; that is a matter of the tolerance.

figure, axes = plt.subplots(1, 2, figsize=(8, 3.9))
for ax, name in zip(axes, ("ost", "smrf"), strict=True):
    found = jf.FILTERS[name].for_cloud(cloud)(cloud)
    jf.plots.error_map(cloud, found, scene.truth, ax=ax, title=name.upper())

# %%
# What a method can be told
# -------------------------
#
# Parameters have the same name for the same quantity in all methods; ``help(jf.SMRF)`` has units and ranges, and so has
# the :doc:`reference </docs/api/filters>`. Set first what depends on the scene: the largest building, then the slope of the
# terrain, then the tolerance.

smrf = jf.SMRF.for_cloud(cloud, largest_building=20.0)
smrf

# %%
# A filter is frozen; ``replace`` makes another. A value that cannot be is refused:

smrf = smrf.replace(threshold=0.25)
try:
    smrf.replace(slope=-0.1)
except jf.ParameterError as error:
    print(error)

# %%
# A smaller tolerance loses some ground and lets fewer plants pass:

for threshold in (0.5, 0.25, 0.1):
    scores = jf.evaluate(
        smrf.replace(threshold=threshold)(cloud), scene.truth, candidates_only=True
    )
    print(
        f"{threshold:4} m: Type I {scores.type1:5.2f} %, Type II {scores.type2:5.2f} %, total {scores.total:5.2f} %"
    )

# %%
# Which value is right is a matter of the data: :ref:`sphx_glr_docs_made_tutorials_d_sweeps.py` and
# :ref:`sphx_glr_docs_made_tutorials_e_few_clicks.py` find it.
