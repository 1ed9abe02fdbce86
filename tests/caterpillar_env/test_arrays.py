import numpy as np
import pytest

from caterpillar_env.arrays import cross, select


@pytest.mark.parametrize("rows", [[0, 1, 2], [2, 1, 0], [0, 2], [1], []])
def test_selection_gives_the_same_rows(rows):
    index = np.array(rows, dtype=np.intp)
    values = np.arange(6.0).reshape(3, 2)
    np.testing.assert_array_equal(values[select(index, 3)], values[index])


def test_all_rows_in_order_are_selected_without_a_copy():
    values = np.zeros((3, 2))
    assert values[select(np.arange(3), 3)].base is values


def test_cross_product_equals_that_of_numpy():
    a, b = np.random.default_rng(0).normal(size=(2, 5, 4, 3))
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))
