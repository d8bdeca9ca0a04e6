"""Weights of the model of doubt. Made by ``experiments/default/doubt.py``, from simulated scenes and labelled tiles."""

import numpy as np

MODEL = np.array(
    [
        [0.3294, -2.5382, -0.9885, 0.8877, 0.0509, 0.9186, 0.0000, 1.9957, 0.8644, -0.0805],  # not ground
        [-4.0219, -0.5654, 3.8082, -2.8247, 0.3432, 0.7926, 0.8110, 1.6267, -0.7878, 0.7916],  # ground
    ]
)
"""f64[2, 1 + features]: constant and weights, for points that are not ground and for ground."""
