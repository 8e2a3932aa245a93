"""What editors and type checkers know of keywords is what the parameters are."""

import inspect
from collections.abc import Callable, Iterator
from dataclasses import fields
from importlib import import_module
from types import ModuleType
from typing import Any, get_type_hints

from own_modules import modules_of

import stages

SHARED = ("stages.simplification.shared_params", "stages.simplification.keywords")
MODULES = modules_of(stages)


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


def test_every_class_of_keywords_agrees_with_its_parameters_in_names_and_types():
    found = [c for module in MODULES for c in classes_of(module) if c.__name__.endswith("Keywords")]
    # Of these, others are made; what `simplify` takes is compared with its table beside the tests of that.
    found = [c for c in found if c.__module__ not in SHARED]
    assert len(found) >= 15
    for keywords in found:
        module = import_module(keywords.__module__)
        name = keywords.__name__.removesuffix("Keywords")
        params = getattr(module, f"{name}Params", None) or getattr(module, name)
        hints = get_type_hints(params)
        assert get_type_hints(keywords) == {field.name: hints[field.name] for field in fields(params)}
        assert not keywords.__required_keys__, f"{keywords}: every parameter has a default"


def test_every_function_that_takes_parameters_by_name_says_which():
    found = list(functions_with_changes())
    assert {"fuse", "clean", "views_depth", "with_"} <= {function.__name__ for function, _ in found}
    for function, signature in found:
        params = signature.parameters.get("params")
        of = "Mesh" if params is None else params.annotation.removesuffix("Params | None")
        said = signature.parameters["changes"].annotation.replace("keywords.", "")
        assert said == f"Unpack[{of}Keywords]", function
