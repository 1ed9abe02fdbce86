import runpy

import numpy as np
import pytest

from caterpillar_env.arrays import compiled, select


@pytest.mark.parametrize("rows", [[0, 1, 2], [2, 1, 0], [0, 2], [1], []])
def test_selection_gives_the_same_rows(rows):
    index = np.array(rows, dtype=np.intp)
    values = np.arange(6.0).reshape(3, 2)
    np.testing.assert_array_equal(values[select(index, 3)], values[index])


def test_all_rows_in_order_are_selected_without_a_copy():
    values = np.zeros((3, 2))
    assert values[select(np.arange(3), 3)].base is values


@pytest.mark.parametrize("writable", [True, False])
def test_function_is_compiled_even_without_a_writable_cache_folder(tmp_path, monkeypatch, writable):
    module, cache = tmp_path / "doubling.py", tmp_path / "__pycache__"
    module.write_text("def double(x):\n    return 2 * x\n")
    if not writable:  # no folder can be made in the place of a file
        cache.touch()
        monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    double = compiled(runpy.run_path(str(module))["double"])
    assert double(3) == 6
    assert bool(list(tmp_path.glob("__pycache__/*.nbi"))) is writable
