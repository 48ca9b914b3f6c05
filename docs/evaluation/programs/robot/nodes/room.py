"""The room that the robot is in: 10 m by 10 m, in cells of 5 cm, with walls, shelves and doors."""

import numpy as np

CELL = 0.05
SIZE = 200
BEAMS = 360
ANGLES = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
RANGE = 10.0
"""Metres."""


def room():
    """Whether each cell [y, x] is occupied."""
    grid = np.zeros((SIZE, SIZE), bool)
    grid[[0, -1], :] = grid[:, [0, -1]] = True
    grid[95:100, :70] = grid[95:100, 110:] = True
    for x, y in ((40, 40), (150, 30), (30, 150), (120, 160)):
        grid[y : y + 12, x : x + 20] = True
    return grid


def scan(grid, x, y, heading):
    """Metres to the next occupied cell, by beam."""
    far = np.arange(CELL, RANGE, CELL)
    angles = ANGLES + heading
    columns = ((x + np.outer(np.cos(angles), far)) / CELL).astype(int).clip(0, SIZE - 1)
    rows = ((y + np.outer(np.sin(angles), far)) / CELL).astype(int).clip(0, SIZE - 1)
    return far[grid[rows, columns].argmax(axis=1)]
