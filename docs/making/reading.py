"""An extension of griffe, which reads the source for the reference: our sections, and the shapes of jaxtyping."""

import dataclasses
import re
from collections.abc import Iterator
from typing import Any

import griffe

SHAPED = {"Bool", "Float", "Int", "Int8", "Real"}
"""Names behind which a text in brackets is the shape of an array, and no type that was put in quotes."""


class Reading(griffe.Extension):
    """Our "Fields:" are griffe's "Attributes:"; a shape such as `Float[Array, "obs *lanes"]` stays as it is."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Called with each object once it is read."""
        if obj.docstring is not None:
            text = re.sub(r"^Fields:$", "Attributes:", obj.docstring.value, flags=re.MULTILINE)
            # Fields that share a line: a blank between them would make the second one the first one's type.
            obj.docstring.value = re.sub(r"^( {4}\w+), (\w+:)", r"\1,\2", text, flags=re.MULTILINE)
        for annotation in _annotations(obj):
            _restore(annotation)


def _annotations(obj: Any) -> Iterator[Any]:
    if obj.is_function:
        yield obj.returns
        yield from (parameter.annotation for parameter in obj.parameters)
    elif obj.is_attribute:
        yield obj.annotation


def _restore(expression: Any) -> None:
    """Puts the shapes within an expression back into quotes."""
    if not isinstance(expression, griffe.Expr):
        return
    if isinstance(expression, griffe.ExprSubscript) and str(expression.left) in SHAPED:
        inside = expression.slice
        if isinstance(inside, griffe.ExprTuple) and isinstance(inside.elements[-1], griffe.Expr):
            shape = str(inside.elements[-1]).replace(" * ", " *")
            expression.slice.elements = [*inside.elements[:-1], f'"{shape}"']
    for field in dataclasses.fields(expression):
        value = getattr(expression, field.name)
        for each in value if isinstance(value, (list, tuple)) else [value]:
            _restore(each)
