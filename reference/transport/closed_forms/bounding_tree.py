"""A bounding volume hierarchy that is walked without a stack: nodes in depth-first order, each knowing where to go on
when its box is missed (Smits 1998, "Efficiency issues for ray tracing", section 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...datatypes import F64, I64


@dataclass(frozen=True, eq=False)
class BoundingTree:
    """N = 2 T − 1 nodes over T primitives. lower, upper (N, 3) m. skip (N,): the node after this one's subtree; N ends
    the walk. primitive (N,): the one in a leaf, −1 in inner nodes, whose first child is the next node."""

    lower: F64
    upper: F64
    skip: I64
    primitive: I64


def build_tree(lower: F64, upper: F64) -> BoundingTree:
    """Tree over boxes (T, 3), halved at the median of their centres along the longest extent, all nodes of a depth at once.

    Raises ValueError without boxes.
    """
    count = len(lower)
    if count == 0:
        raise ValueError("a bounding tree needs at least one box, got 0")
    nodes = 2 * count - 1
    tree = BoundingTree(np.zeros((nodes, 3)), np.zeros((nodes, 3)), np.zeros(nodes, np.int64), np.full(nodes, -1))
    centres, order = lower + upper, np.arange(count)
    first, size, node = (np.array([x], dtype=np.int64) for x in (0, count, 0))
    while len(first):
        taken = _ranges(first, size)
        members = order[taken]
        starts = np.concatenate([[0], np.cumsum(size)[:-1]])
        tree.lower[node] = np.minimum.reduceat(lower[members], starts)
        tree.upper[node] = np.maximum.reduceat(upper[members], starts)
        tree.skip[node] = node + 2 * size - 1
        leaf = size == 1
        tree.primitive[node[leaf]] = order[first[leaf]]
        c = centres[members]
        axis = np.argmax(np.maximum.reduceat(c, starts) - np.minimum.reduceat(c, starts), axis=1)
        owner = np.repeat(np.arange(len(size)), size)
        order[taken] = members[np.lexsort((c[np.arange(len(c)), axis[owner]], owner))]
        inner = ~leaf
        first, size, node = first[inner], size[inner], node[inner]
        half = (size + 1) // 2
        first, size, node = (
            np.concatenate([first, first + half]),
            np.concatenate([half, size - half]),
            np.concatenate([node + 1, node + 2 * half]),
        )
    return tree


def _ranges(first: I64, size: I64) -> I64:
    """first_k, first_k + 1, … first_k + size_k − 1 for every k, one after another."""
    starts = np.concatenate([[0], np.cumsum(size)[:-1]])
    return np.arange(int(size.sum())) + np.repeat(first - starts, size)
