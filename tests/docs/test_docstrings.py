"""What `help(gpcjax.NAME)` and the reference say of each public name is whole."""

import inspect
import re

import pytest

import gpcjax

FUNCTIONS = [name for name in gpcjax.__all__ if not inspect.isclass(getattr(gpcjax, name))]
CLASSES = [name for name in gpcjax.__all__ if name not in FUNCTIONS]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_names_its_arguments_and_its_errors(name):
    function = getattr(gpcjax, name)
    text, arguments = inspect.getdoc(function), inspect.signature(function).parameters
    for argument in arguments:
        assert re.search(rf"(^|[ *,]){argument}\b.*:", text, re.MULTILINE), argument
    assert not arguments or re.search(r"^Raises:\n +\w+Error: ", text, re.MULTILINE)


@pytest.mark.parametrize("name", CLASSES)
def test_a_class_documents_its_fields_and_methods(name):
    """A field in the class's own text, or in one behind it."""
    found = getattr(gpcjax, name)
    text, source = inspect.getdoc(found), inspect.getsource(found)
    for field in getattr(found, "__dataclass_fields__", {}):
        behind = re.search(rf'^    {field}: [^\n]*\n    """', source, re.MULTILINE)
        assert field.startswith("_") or behind or re.search(rf"\b{field}\b", text), field
    for method, value in vars(found).items():
        if not method.startswith("_") and (inspect.isfunction(value) or isinstance(value, property)):
            assert inspect.getdoc(getattr(found, method)), method


def test_help_says_what_there_is():
    """Each public name, and none that there is not."""
    text = gpcjax.__doc__
    assert text.startswith("Teach continuous controllers by corrective advice")
    table = "".join(line for line in text.splitlines() if line.startswith("|"))
    assert {*re.findall(r"`(\w+)`", table)} == {*gpcjax.__all__}
    assert set(gpcjax.__all__) <= set(dir(gpcjax))
