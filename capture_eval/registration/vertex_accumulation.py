"""What constraints on material points say about vertices: counts, weights and weighted means."""

import numpy as np
from numpy.typing import NDArray

from capture_eval.errors import InputError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def accumulate_to_vertices(
    triangle: Integers, barycentric: Floats, values: Floats, triangles: Integers, vertex_count: int
) -> Floats:
    """Hand values of surface points to the corners of their triangles in proportion to the barycentric weights.

    The sum over the vertices is the sum over the points. With ones the result counts the points near each
    vertex; with weights it is their support.

    Parameters
    ----------
    triangle : (M,) int64
    barycentric : (M, 3) float64
    values : (M,) or (M, n) float64
    triangles : (K, 3) int64
    vertex_count : int

    Returns
    -------
    (V,) or (V, n) float64

    Raises
    ------
    InputError
        Shapes that do not fit.

    Examples
    --------
    >>> one = np.array([[0.5, 0.25, 0.25]])
    >>> accumulate_to_vertices(np.array([0]), one, np.array([4.0]), np.array([[0, 1, 2]]), 3)
    array([2., 1., 1.])
    """
    values = np.asarray(values, dtype=np.float64)
    if barycentric.shape != (len(triangle), 3) or len(values) != len(triangle):
        raise InputError(
            f"constraints: {triangle.shape} triangles, {barycentric.shape} barycentric weights, {values.shape} values"
        )
    corners = triangles[triangle].ravel()
    columns = values.reshape(len(triangle), int(np.prod(values.shape[1:])))
    sums = np.empty((vertex_count, columns.shape[1]))
    for index in range(columns.shape[1]):
        shared = (barycentric * columns[:, index, None]).ravel()
        sums[:, index] = np.bincount(corners, shared, minlength=vertex_count)
    return sums[:, 0] if values.ndim == 1 else sums.reshape(vertex_count, *values.shape[1:])


def weighted_vertex_mean(
    triangle: Integers, barycentric: Floats, values: Floats, weight: Floats, triangles: Integers, vertex_count: int
) -> tuple[Floats, Floats]:
    """Weighted mean of ``values`` (M,) near each vertex, (V,), NaN where there are none, and its weight (V,)."""
    both = np.stack([values * weight, weight], axis=1)
    sums = accumulate_to_vertices(triangle, barycentric, both, triangles, vertex_count)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(sums[:, 1] > 0, sums[:, 0] / sums[:, 1], np.nan), sums[:, 1]
