"""
Where labels are wrong: error_map
=================================

Type I errors are ground that was lost, Type II errors are objects that were taken for ground. What was found of the objects
is tinted.
"""

import jaxfilter as jf

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
result = jf.SMRF()(scene.cloud)
ax = jf.plots.error_map(scene.cloud, result, scene.truth, title="SMRF")
