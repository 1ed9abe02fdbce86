"""The packages import their public names on first use."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import caterpillar_env
import evolution


@pytest.mark.parametrize("package", [caterpillar_env, evolution], ids=lambda p: p.__name__)
def test_type_checkers_see_the_names_that_are_imported_on_first_use(package):
    tree = ast.parse(Path(package.__file__).read_text("utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    assert ast.unparse(block.test) == "TYPE_CHECKING"
    seen = {
        alias.asname: f"{statement.module}.{alias.name}"
        for statement in block.body
        for alias in statement.names
    }
    root = package.__name__
    assert seen == {name: f"{root}.{module}.{name}" for name, module in package._MODULES.items()}
    for name in package.__all__:
        assert getattr(package, name) is not None


@pytest.mark.parametrize(("package", "name"), [(caterpillar_env, "robots"), (evolution, "Robot")])
def test_unknown_names_raise_an_attribute_error(package, name):
    with pytest.raises(AttributeError, match=f"module '{package.__name__}' has no attribute '{name}'"):
        getattr(package, name)


@pytest.mark.parametrize("package", ["caterpillar_env", "evolution"])
def test_import_of_a_package_does_not_load_its_modules(package):
    code = f"import sys, {package}; print(sorted(sys.modules))"
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = ast.literal_eval(output.stdout)
    assert not {"mujoco", "numba"} & set(loaded)
    own = [name for name in loaded if name.startswith(f"{package}.")]
    assert own == (["caterpillar_env.errors"] if package == "caterpillar_env" else [])
