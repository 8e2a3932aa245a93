"""Functions that take fields of a class as keywords declare them for editors and type checkers."""

import inspect
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

from importable_modules import import_modules

from scanloom import stages

MODULES = import_modules(stages)


def list_classes(module: ModuleType) -> list[type]:
    return [c for c in vars(module).values() if inspect.isclass(c) and c.__module__ == module.__name__]


def find_functions_with_changes() -> Iterator[tuple[Callable[..., Any], inspect.Signature]]:
    """Find functions and methods that take fields of a class as `**changes`."""
    for module in MODULES:
        for owner in (module, *list_classes(module)):
            for function in vars(owner).values():
                if inspect.isfunction(function) and function.__module__ == module.__name__:
                    signature = inspect.signature(function)
                    kinds = {name: one.kind for name, one in signature.parameters.items()}
                    if kinds.get("changes") is inspect.Parameter.VAR_KEYWORD:
                        yield function, signature


def test_every_function_with_changes_declares_its_keywords():
    found = list(find_functions_with_changes())
    assert {"fuse", "clean", "views_depth", "with_"} <= {function.__name__ for function, _ in found}
    for function, signature in found:
        params = signature.parameters.get("params")
        of = "Mesh" if params is None else params.annotation.removesuffix("Params | None")
        said = signature.parameters["changes"].annotation.replace("keywords.", "")
        assert said == f"Unpack[{of}Keywords]", function
