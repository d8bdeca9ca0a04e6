"""Weights of the model of doubt. Made by ``experiments/default/doubt.py``, from simulated scenes and labelled tiles."""

import numpy as np

MODEL = np.array(
    [
        [-2.8332, -1.7732, 0.8161, 0.7314, 0.0426, 0.9519, 0.0000, 2.5308, 1.0643, 0.9964],  # not ground
        [-3.9382, -0.9223, 3.8281, -3.3887, 0.3492, 0.9354, 0.8984, 1.6111, -0.5091, 0.6215],  # ground
    ]
)
"""f64[2, 1 + features]: constant and weights, for points that are not ground and for ground."""
