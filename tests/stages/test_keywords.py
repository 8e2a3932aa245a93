"""Functions that take fields of a class by name say so to editors and type checkers."""

import inspect
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

from importable_modules import import_modules

from scanloom import stages

MODULES = import_modules(stages)


def classes_of(module: ModuleType) -> list[type]:
    return [c for c in vars(module).values() if inspect.isclass(c) and c.__module__ == module.__name__]


def functions_with_changes() -> Iterator[tuple[Callable[..., Any], inspect.Signature]]:
    """Functions and methods that take fields of a class by name, as `**changes`."""
    for module in MODULES:
        for owner in (module, *classes_of(module)):
            for function in vars(owner).values():
                if inspect.isfunction(function) and function.__module__ == module.__name__:
                    signature = inspect.signature(function)
                    kinds = {name: one.kind for name, one in signature.parameters.items()}
                    if kinds.get("changes") is inspect.Parameter.VAR_KEYWORD:
                        yield function, signature


def test_every_function_that_takes_parameters_by_name_says_which():
    found = list(functions_with_changes())
    assert {"fuse", "clean", "views_depth", "with_"} <= {function.__name__ for function, _ in found}
    for function, signature in found:
        params = signature.parameters.get("params")
        of = "Mesh" if params is None else params.annotation.removesuffix("Params | None")
        said = signature.parameters["changes"].annotation.replace("keywords.", "")
        assert said == f"Unpack[{of}Keywords]", function
