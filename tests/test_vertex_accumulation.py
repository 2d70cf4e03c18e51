"""Sums of constraints at vertices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_eval.errors import InputError
from capture_eval.registration.vertex_accumulation import accumulate_to_vertices, weighted_vertex_mean

TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 50))
def test_nothing_is_lost(seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    barycentric = generator.dirichlet((1.0, 1.0, 1.0), size=count).reshape(count, 3)
    values = generator.normal(size=(count, 2))
    sums = accumulate_to_vertices(generator.integers(0, 2, count), barycentric, values, TRIANGLES, 5)
    np.testing.assert_allclose(sums.sum(axis=0), values.sum(axis=0), atol=1e-12)
    assert np.all(sums[4] == 0)


def test_means_by_hand() -> None:
    triangle = np.array([0, 1])
    barycentric = np.array([[1.0, 0.0, 0.0], [0.5, 0.5, 0.0]])
    mean, weight = weighted_vertex_mean(triangle, barycentric, np.array([2.0, 8.0]), np.array([1.0, 2.0]), TRIANGLES, 4)
    # Vertex 0: 2 with weight 1 and 8 with weight 2 x 0.5; vertex 2: 8 with weight 1.
    np.testing.assert_allclose(mean, [5.0, np.nan, 8.0, np.nan])
    np.testing.assert_allclose(weight, [2.0, 0.0, 1.0, 0.0])


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="constraints"):
        accumulate_to_vertices(np.array([0]), np.ones((2, 3)), np.ones(1), TRIANGLES, 4)
