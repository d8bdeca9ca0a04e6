"""
All at a glance: panel
======================

Ground of the reference, ground that was found, errors and a section: a figure for a paper. It returns the Figure.
"""

import jaxfilter as jf

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
figure = jf.plots.panel(scene.cloud, jf.SMRF()(scene.cloud), scene.truth)
