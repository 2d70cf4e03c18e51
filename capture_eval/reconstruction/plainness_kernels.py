"""Compiled measure of how much a photo varies around a pixel, among pixels like it."""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,misc,untyped-decorator"

import numpy as np

from capture_eval.reconstruction.patch_cost_kernels import rows_kernel

_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)


@rows_kernel
def plainness_rows(rows, padded, stride, pad, centre, radius, reach, variance):
    """Grey variance among the pixels around a pixel that look like it (biweight of width `reach`).

    What lies beyond an outline does not count, so a plain backdrop stays plain right up to it.
    """
    width = centre.shape[1]
    inverse = _ONE / (reach * reach)
    for v in range(rows[0], rows[1]):
        for u in range(width):
            middle = centre[v, u]
            total = _ZERO
            first = _ZERO
            second = _ZERO
            for dy in range(-radius, radius + 1):
                base = np.uint32((v + dy + pad) * stride + u + pad - radius)
                for k in range(np.uint32(2 * radius + 1)):
                    value = padded[np.uint32(base + np.uint32(k))] - middle
                    weight = max(_ONE - value * value * inverse, _ZERO)
                    weight *= weight
                    total += weight
                    first += weight * value
                    second += weight * value * value
            mean = first / total
            variance[v, u] = second / total - mean * mean
