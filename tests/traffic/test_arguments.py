from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from marl_lanes.traffic.arguments import (
    check_flag,
    check_form,
    check_functions,
    check_whole,
    is_on_gpu,
    read_mask,
    read_numbers,
)


def test_whole_numbers_and_flags_become_pythons():
    assert type(check_whole("n", np.uint8(3), 0, 3)) is int
    assert type(check_flag("is", np.False_)) is bool
    with pytest.raises(ValueError, match=r"^n = 4: must be a whole number, 0 to 3$"):
        check_whole("n", 4, 0, 3)
    with pytest.raises(ValueError, match=r"^n = True: must be a whole number, 0 to 2\^63 - 1$"):
        check_whole("n", True, 0, 2**63 - 1)
    with pytest.raises(ValueError, match=r"^is = 'no': must be True or False$"):
        check_flag("is", "no")


def test_functions_have_names():
    check_functions("policies", None)
    check_functions("policies", {"mine": len})
    with pytest.raises(ValueError, match=r"^policies = 3: must be a mapping of names"):
        check_functions("policies", 3)
    with pytest.raises(ValueError, match=r"^policies\['mine'\] = 3: must be a function"):
        check_functions("policies", {"mine": 3})


def test_numbers_are_not_copied_without_need():
    given = np.zeros((2, 3))
    assert read_numbers("a", given, (2, 3)) is given
    assert read_numbers("a", [[1, 2, 3]], (1, 3)).tolist() == [[1.0, 2.0, 3.0]]
    with pytest.raises(ValueError, match=r"^a: shape \(2, 3\), must be \(3, 2\)$"):
        read_numbers("a", given, (3, 2))
    with pytest.raises(ValueError, match=r"^a = \[1j\]: must be real numbers .* type complex128$"):
        read_numbers("a", [1j], (1,))
    with pytest.raises(ValueError, match=r"^a: must be ordinary numbers, is a masked array$"):
        read_numbers("a", np.ma.masked_array([1.0]), (1,))


def test_a_mask_is_contiguous():
    mask = read_mask("mask", np.array([True, False, True, False])[::2], (2,))
    assert mask.flags.c_contiguous
    assert mask.tolist() == [True, True]
    with pytest.raises(ValueError, match=r"^mask = \[1, 0\]: must be True or False"):
        read_mask("mask", [1, 0], (2,))


@pytest.mark.parametrize(
    ("form", "index", "message"),
    [
        ({"typestr": "<f4", "shape": (2, 3)}, 1, None),
        ({"typestr": "<f4", "shape": (2, 3)}, None, None),
        ({"typestr": "<f4", "shape": (2, 3)}, 0, r"^x: is on cuda:0, must be on cuda:1$"),
        ({"typestr": "<f4", "shape": (3, 2)}, 1, r"^x: shape \(3, 2\), must be \(2, 3\)$"),
        ({"typestr": "|b1", "shape": (2, 3)}, 1, r"^x = .*: must not be of type \|b1$"),
    ],
)
def test_arrays_on_a_gpu(form, index, message):
    given = SimpleNamespace(__cuda_array_interface__=form)
    if index is not None:
        given.device = SimpleNamespace(index=index)
    expected = nullcontext() if message is None else pytest.raises(ValueError, match=message)
    assert is_on_gpu(given)
    with expected:
        check_form("x", given, (2, 3), "fd", "cuda:1")
