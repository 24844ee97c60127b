"""Checks: names bind, and an error is one line that names the place, the expectation, the fact and the remedy."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
import torch

from renderers.checks import ShapeError, UserError, check_finite, check_range, check_shapes


def test_a_user_error_is_one_line():
    error = UserError("walk.bvh, line 3", "has no frames", "give a clip")
    assert str(error) == "walk.bvh, line 3: has no frames; give a clip"
    assert (error.where, error.problem, error.remedy) == ("walk.bvh, line 3", "has no frames", "give a clip")
    assert str(UserError("a", "b")) == "a: b"
    assert isinstance(ShapeError("a", "b"), UserError)


def test_names_bind_across_tensors():
    with pytest.raises(ShapeError, match=r"f\(b\): expected shape \[N\] with N=2, got \[3\]"):
        check_shapes("f", a=(torch.zeros(2, 5, 3), "N V 3"), b=(torch.zeros(3), "N"))


def test_names_bind_within_one_tensor():
    with pytest.raises(ShapeError, match=r"\[B N N\]"):
        check_shapes("f", a=(torch.zeros(2, 3, 4), "B N N"))


def test_names_bind_across_calls():
    bound = check_shapes("f", a=(np.zeros((2, 5)), "N V"))
    assert bound == {"N": 2, "V": 5}
    with pytest.raises(ShapeError):
        check_shapes("f", bound, c=(torch.zeros(4), "V"))
    assert bound == {"N": 2, "V": 5}


@pytest.mark.parametrize("shape", [(3,), (4, 3), (2, 4, 3)])
def test_an_ellipsis_takes_any_batch(shape):
    assert check_shapes("f", a=(torch.zeros(shape), "... 3")) == {}


@pytest.mark.parametrize(("shape", "axes"), [((2,), "... 3"), ((), "... 3"), ((2, 3), "3"), ((3,), "N 3")])
def test_wrong_ranks_and_sizes_are_refused(shape, axes):
    with pytest.raises(ShapeError, match=r"got \["):
        check_shapes("f", a=(torch.zeros(shape), axes))


def test_the_first_value_that_is_not_finite_is_named():
    values = torch.zeros(4, 2, 3)
    values[2, 1, 0], values[3, 0, 0] = float("nan"), float("inf")
    with pytest.raises(UserError, match=r"x.bvh: value nan at frame 2, joint knee, axis 0 \(2 of 24 values") as caught:
        check_finite("x.bvh", values, "frame joint axis", {"joint": ("hip", "knee")})
    assert caught.value.remedy == "repair or crop the file"


def test_finite_values_pass():
    check_finite("x", np.array([0.0, -1e300]), "frame")


@dataclass(frozen=True)
class Size:
    width: float = 1.0
    height: float = 1.0


def test_a_range_holds_its_ends_and_no_nan():
    check_range(Size(1, 4), 1, 4, "width", "height")
    with pytest.raises(UserError, match=r"Size\(height\): expected 1 to 4, got 5"):
        check_range(Size(1, 5), 1, 4, "width", "height")
    with pytest.raises(UserError, match=r"Size\(width\): expected 0 or more, got nan"):
        check_range(Size(math.nan), 0, math.inf, "width")
