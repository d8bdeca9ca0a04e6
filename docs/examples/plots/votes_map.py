"""
Points that depend on parameters: votes_map
===========================================

Votes are the share of sets that call a point ground. They need no reference: a sweep of a cloud that nobody has labelled
says where its parameters matter.
"""

import jaxfilter as jf

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
axes = {
    "slope": [0.05, 0.1, 0.15, 0.2, 0.3],
    "threshold": [0.2, 0.4, 0.6, 0.8],
    "scaling": [0.0, 1.25, 2.5],
}
sweep = jf.sweep(jf.SMRF(), scene.cloud, axes, votes=True)
ax = jf.plots.votes_map(scene.cloud, sweep["votes"].values)
