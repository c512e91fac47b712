"""Columns and their products in one kernel: for NVIDIA GPUs with matrix units for float64, and for
a core where there is a C compiler."""

from ._host_kernel import HostKernel as HostKernel, host_kernel_of as host_kernel_of
from ._kernel import GramKernel as GramKernel, gram_kernel as gram_kernel
from ._products import (
    fused_gram_matrices as fused_gram_matrices,
    fused_kernel_of as fused_kernel_of,
    packed_inverses as packed_inverses,
    unpacked_products as unpacked_products,
)
