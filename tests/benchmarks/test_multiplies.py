"""How much arithmetic a step takes."""

from __future__ import annotations

import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from llvmlite import binding

from benchmarks import multiplies
from benchmarks.contestants import native
from benchmarks.workload import Case
from cranedyn.errors import CraneError
from tests.helpers import crane

LOOP = """
first:
    vmulpd %zmm0, %zmm1, %zmm2
    jne first
steps:
    vmulpd %zmm0, %zmm1, %zmm2
    vfnmadd231pd %zmm0, %zmm1, %zmm2
    vaddpd %zmm0, %zmm1, %zmm2
    vsubpd %zmm0, %zmm1, %zmm2
    vdivpd %zmm0, %zmm1, %zmm2
    jle steps
    vmulpd %zmm0, %zmm1, %zmm2
more:
    vmulpd %zmm0, %zmm1, %zmm2
    vmulpd %zmm0, %zmm1, %zmm2
    vmulpd %zmm0, %zmm1, %zmm2
    jmp away
"""


def test_the_loop_with_the_most_products_is_counted() -> None:
    assert multiplies.arithmetic_of_step(LOOP) == (1, 1, 2, 1)


def test_code_without_a_loop_is_refused() -> None:
    with pytest.raises(CraneError, match="AVX-512"):
        multiplies.arithmetic_of_step("start:\n    vmulpd %zmm0, %zmm1, %zmm2\n    ret\n")


@pytest.mark.skipif(
    not binding.get_host_cpu_features().get("avx512f"), reason="the processor has no AVX-512"
)
@pytest.mark.skipif(native.compiler() is None, reason="there is no C compiler")
def test_a_step_of_a_crane_takes_no_more_products_than_that_by_hand() -> None:
    ours = multiplies.step_of_batch(crane())
    by_hand = multiplies.step_of_c(Case())
    assert ours.products + ours.fused <= by_hand.products + by_hand.fused
    assert ours.products + ours.fused + ours.sums < by_hand.products + by_hand.fused + by_hand.sums
