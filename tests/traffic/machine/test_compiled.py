import numba
import pytest

from marl_lanes.traffic.driving import acceleration


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="numba's compilation is switched off")
def test_an_internal_kernel_refuses_a_call_from_python():
    with pytest.raises(TypeError, match=r"accelerate\(\) can be called by other kernels only"):
        acceleration.accelerate()
