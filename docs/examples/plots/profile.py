"""
A section: profile
==================

The points of a strip along a line, here of 2 m. With ``reference`` errors stand out.
"""

import jaxfilter as jf

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
result = jf.FPTD()(scene.cloud)
ax = jf.plots.profile(
    scene.cloud, result, ((0.0, 35.0), (88.0, 35.0)), width=2.0, reference=scene.truth
)
