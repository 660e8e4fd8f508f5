"""PyTorch side of deepct: train the network, export its weights, check them.

Volumes are ``[z, y, x]`` (extinction, 1/km), images ``[view, row, col]`` (radiance,
1/sr); a batch has one axis before them.
"""

__version__ = "0.1.0"
