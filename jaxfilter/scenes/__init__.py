"""Simulated surveys whose truth is known at every point: ``scenes.make("town", density=4)``.

>>> sorted(jf.scenes.LAYOUTS)[:3]
['benches', 'benchmark', 'canopy']
>>> jf.scenes.make("hills", size=30, density=1, seed=1)
Scene(981 points on 30 x 30 m, 78.6 % ground, seed 1)
"""

from .layouts import ASPRS, LAYOUTS, Kind, SceneLayout
from .scene import Scene, make
from .sensors import SENSORS, Sensor

__all__ = ["ASPRS", "LAYOUTS", "SENSORS", "Kind", "SceneLayout", "Scene", "Sensor", "make"]
